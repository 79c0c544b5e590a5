//! Several sources as one, their scans in order of time.

use std::sync::Arc;

use tsdfuse::{Scan, Trajectory};

use crate::error::{Error, Result};
use crate::source::{GnssFix, ImageRef, ImuSample, ScanRef, Sensor, Source};

/// Sources that are read as one.
pub(crate) struct Together {
    sources: Vec<Arc<dyn Source>>,
    format: String,
    sensors: Vec<Sensor>,
    scans: Vec<ScanRef>,
    /// Source and number there of each scan.
    places: Vec<(usize, usize)>,
    images: Vec<ImageRef>,
    image_places: Vec<(usize, usize)>,
    notes: Vec<String>,
}

impl Together {
    pub(crate) fn new(sources: Vec<Arc<dyn Source>>) -> Result<Self> {
        let mut this = Self {
            format: String::new(),
            sensors: Vec::new(),
            scans: Vec::new(),
            places: Vec::new(),
            images: Vec::new(),
            image_places: Vec::new(),
            notes: Vec::new(),
            sources,
        };
        let mut formats: Vec<&str> = Vec::new();
        let mut placed = Vec::new();
        for (number, source) in this.sources.iter().enumerate() {
            if !formats.contains(&source.format()) {
                formats.push(source.format());
            }
            for (index, scan) in source.scans().iter().enumerate() {
                let time_ns = scan.time_ns.ok_or_else(|| {
                    let reason = "has no time, so it cannot be put in order with the scans of other sensors";
                    Error::dataset(&scan.name, reason)
                })?;
                let sensor = this.sensors.len() + scan.sensor;
                placed.push((time_ns, (number, index), ScanRef { sensor, ..scan.clone() }));
            }
            this.images.extend_from_slice(source.images());
            this.image_places
                .extend((0..source.images().len()).map(|image| (number, image)));
            this.notes.extend_from_slice(source.notes());
            for sensor in source.sensors() {
                let taken = |name: &str| this.sensors.iter().any(|other| other.name == name);
                let numbered = (2..).map(|k| format!("{}-{k}", sensor.name));
                let mut names = std::iter::once(sensor.name.clone()).chain(numbered);
                let name = names.find(|name| !taken(name)).unwrap_or_default();
                this.sensors.push(Sensor { name, ..sensor.clone() });
            }
        }
        this.format = formats.join(" + ");
        placed.sort_by_key(|&(time_ns, place, _)| (time_ns, place));
        (this.places, this.scans) = placed.into_iter().map(|(_, place, scan)| (place, scan)).unzip();
        Ok(this)
    }

    /// What the first source that has any knows: samples of two units must not be mixed.
    fn first<T>(&self, of: impl Fn(&dyn Source) -> Result<Vec<T>>) -> Result<Vec<T>> {
        for source in &self.sources {
            let samples = of(source.as_ref())?;
            if !samples.is_empty() {
                return Ok(samples);
            }
        }
        Ok(Vec::new())
    }
}

impl Source for Together {
    fn format(&self) -> &str {
        &self.format
    }

    fn sensors(&self) -> &[Sensor] {
        &self.sensors
    }

    fn scans(&self) -> &[ScanRef] {
        &self.scans
    }

    fn read(&self, index: usize) -> Result<Scan> {
        let (source, scan) = self.places[index];
        self.sources[source].read(scan)
    }

    fn trajectory(&self) -> Option<&Trajectory> {
        self.sources.iter().find_map(|source| source.trajectory())
    }

    fn imu(&self) -> Result<Vec<ImuSample>> {
        self.first(|source| source.imu())
    }

    fn gnss(&self) -> Result<Vec<GnssFix>> {
        self.first(|source| source.gnss())
    }

    fn images(&self) -> &[ImageRef] {
        &self.images
    }

    fn read_image(&self, index: usize) -> Result<Vec<u8>> {
        let place = self.image_places.get(index);
        let &(source, image) = place.ok_or_else(|| Error::dataset(&self.format, format!("no image {index}")))?;
        self.sources[source].read_image(image)
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}
