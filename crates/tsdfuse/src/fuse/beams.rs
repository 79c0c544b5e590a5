//! The beams of the sensor, for methods that need to know them: stated, or guessed from the first scan.

use std::borrow::Cow;

use super::FuseError;
use crate::{
    scan::Scan,
    sensor::{NEIGHBOUR_CELLS, SensorModel, grid_of, guess, recover_rings},
};

/// The rings of a scan: its own, or recovered ones.
pub fn rings_of<'a>(scan: &'a Scan, model: &SensorModel) -> Cow<'a, [u16]> {
    match &scan.rings {
        Some(rings) => Cow::Borrowed(rings),
        None => Cow::Owned(recover_rings(&scan.points, model).rings),
    }
}

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

    /// The rows of a scan: its beams; where none show, those of a grid as fine as its returns.
    ///
    /// # Errors
    /// As [`Self::of`], if none of the returns is valid.
    pub fn or_grid<'a>(&'a mut self, scan: &'a Scan) -> Result<Rows<'a>, FuseError> {
        match self.of(scan) {
            Ok(sensor) => Ok(Rows {
                rings: rings_of(scan, sensor),
                sensor: Cow::Borrowed(sensor),
                neighbour_cells: 1,
            }),
            Err(error) => {
                let (grid, rings) = grid_of(&scan.points).ok_or(error)?;
                Ok(Rows {
                    sensor: Cow::Owned(grid),
                    rings: rings.into(),
                    neighbour_cells: NEIGHBOUR_CELLS,
                })
            }
        }
    }
}

/// The rows of a scan's organized image.
#[derive(Debug)]
pub struct Rows<'a> {
    /// The sensor's model, or a grid.
    pub sensor: Cow<'a, SensorModel>,
    /// The row of each return.
    pub rings: Cow<'a, [u16]>,
    /// Returns are neighbours if they are at most this many cells apart along a row or a column, and the cells between are empty.
    pub neighbour_cells: usize,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::{model, testing::scan_room};

    #[test]
    fn the_scan_s_own_rings_come_first() {
        let model = model("vlp16").unwrap();
        let (points, rings) = scan_room(&model, |_| 0.0);
        let mut scan = Scan {
            points,
            rings: Some(vec![7; rings.len()]),
            ..Default::default()
        };
        assert!(rings_of(&scan, &model).iter().all(|&r| r == 7));
        scan.rings = None;
        assert!(*rings_of(&scan, &model) == *rings);
    }
}
