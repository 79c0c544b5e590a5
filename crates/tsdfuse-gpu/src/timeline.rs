//! Recording how long each kernel takes, by the device's own clock.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The time that one pass of a kernel took.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stage {
    /// The kernel's name.
    pub name: &'static str,
    /// Seconds from its start to its end.
    pub seconds: f64,
}

/// The passes since recording began.
#[derive(Debug)]
pub(crate) struct Recorder {
    pub(crate) queries: wgpu::QuerySet,
    pub(crate) passes: Vec<&'static str>,
}

/// The recorder, if one is running; shared by all clones of a device.
#[derive(Clone, Debug, Default)]
pub(crate) struct Timeline(Arc<Mutex<Option<Recorder>>>);

/// The most passes that are recorded.
const MOST_PASSES: u32 = 2048;

impl Timeline {
    fn recorder(&self) -> MutexGuard<'_, Option<Recorder>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Starts recording.
    pub(crate) fn start(&self, device: &wgpu::Device) {
        let queries = device.create_query_set(&wgpu::QuerySetDescriptor {
            label: Some("timeline"),
            ty: wgpu::QueryType::Timestamp,
            count: 2 * MOST_PASSES,
        });
        *self.recorder() = Some(Recorder {
            queries,
            passes: Vec::new(),
        });
    }

    /// Stops recording, and returns what was recorded.
    pub(crate) fn stop(&self) -> Option<Recorder> {
        self.recorder().take()
    }

    /// Whether passes are being recorded.
    pub(crate) fn is_running(&self) -> bool {
        self.recorder().is_some()
    }

    /// Begins a pass of kernels, with timestamps while recording.
    pub(crate) fn pass<'a>(&self, encoder: &'a mut wgpu::CommandEncoder, name: &'static str) -> wgpu::ComputePass<'a> {
        let mut recorder = self.recorder();
        let recorded = recorder.as_mut().filter(|r| r.passes.len() < MOST_PASSES as usize);
        let timestamp_writes = recorded.map(|recorder| {
            let at = 2 * recorder.passes.len() as u32;
            recorder.passes.push(name);
            wgpu::ComputePassTimestampWrites {
                query_set: &recorder.queries,
                beginning_of_pass_write_index: Some(at),
                end_of_pass_write_index: Some(at + 1),
            }
        });
        encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some(name),
            timestamp_writes,
        })
    }
}
