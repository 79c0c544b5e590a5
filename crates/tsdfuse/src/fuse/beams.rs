//! The beams of the sensor, for methods that need to know them: stated, or guessed from the first scan.

use super::FuseError;
use crate::{
    scan::Scan,
    sensor::{SensorModel, guess},
};

/// A sensor's model, once it is known.
#[derive(Debug, Default)]
pub struct Beams {
    model: Option<SensorModel>,
}

impl Beams {
    /// The given model; without one, the first scan decides which one it is.
    pub fn new(model: Option<SensorModel>) -> Self {
        Self { model }
    }

    /// The sensor's model, guessed from the scan if it is not known yet.
    ///
    /// # Errors
    /// [`FuseError::Unorganized`] if no beams show in the scan, or if the given model is none.
    pub fn of(&mut self, scan: &Scan) -> Result<&SensorModel, FuseError> {
        let unorganized = |reason: String| FuseError::Unorganized {
            scan: scan.name.clone(),
            reason,
        };
        if self.model.is_none() {
            self.model = guess(&scan.points, scan.rings.as_deref());
        }
        let model = self.model.as_ref().ok_or_else(|| {
            unorganized(
                "no laser beams show in the scan, which this method needs: name the sensor, or use raycast".into(),
            )
        })?;
        model.check().map_err(|e| unorganized(e.to_string()))?;
        Ok(model)
    }
}
