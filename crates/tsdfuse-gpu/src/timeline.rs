//! What each kernel takes, by the device's own clock.

use std::sync::{Arc, Mutex};

use crate::device::{Gpu, GpuError, lock};

/// What one pass of a kernel took.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stage {
    /// The kernel's name.
    pub name: &'static str,
    /// Seconds from its begin to its end.
    pub seconds: f64,
}

/// The passes since recording began.
#[derive(Debug)]
struct Recorder {
    queries: wgpu::QuerySet,
    passes: Vec<&'static str>,
}

/// Shared by all who use a device.
#[derive(Clone, Debug, Default)]
pub(crate) struct Timeline(Arc<Mutex<Option<Recorder>>>);

/// Passes that are recorded at most.
const MOST_PASSES: u32 = 2048;

impl Gpu {
    /// Begins to note what kernels take; false if the device has no clock for that.
    pub fn record_timeline(&self) -> bool {
        if !self.device.features().contains(wgpu::Features::TIMESTAMP_QUERY) {
            return false;
        }
        let queries = self.device.create_query_set(&wgpu::QuerySetDescriptor {
            label: Some("timeline"),
            ty: wgpu::QueryType::Timestamp,
            count: 2 * MOST_PASSES,
        });
        *lock(&self.timeline.0) = Some(Recorder {
            queries,
            passes: Vec::new(),
        });
        true
    }

    /// What kernels took since recording began, in the order in which they were sent (2048 of them at most); recording ends.
    ///
    /// # Errors
    /// [`GpuError::Lost`] if the device is gone.
    pub fn timeline(&self) -> Result<Vec<Stage>, GpuError> {
        let recorder = lock(&self.timeline.0).take();
        let Some(Recorder { queries, passes }) = recorder.filter(|r| !r.passes.is_empty()) else {
            return Ok(Vec::new());
        };
        let count = 2 * passes.len() as u32;
        let usage = wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC;
        let ticks = self.buffer("timeline", 8 * u64::from(count), usage)?;
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.resolve_query_set(&queries, 0..count, &ticks, 0);
        self.queue.submit([encoder.finish()]);
        let ticks: Vec<[u64; 2]> = bytemuck::pod_collect_to_vec(&self.read(&ticks, 0, ticks.size())?);
        let period_secs = f64::from(self.queue.get_timestamp_period()) * 1e-9;
        let stage = |(name, [begin, end]): (&'static str, [u64; 2])| Stage {
            name,
            seconds: end.saturating_sub(begin) as f64 * period_secs,
        };
        Ok(passes.into_iter().zip(ticks).map(stage).collect())
    }

    /// Whether each kernel is to have a pass of its own.
    pub(crate) fn is_timed(&self) -> bool {
        lock(&self.timeline.0).is_some()
    }

    /// Begins a pass of kernels, and notes it where that is wanted.
    pub(crate) fn pass<'a>(&self, encoder: &'a mut wgpu::CommandEncoder, name: &'static str) -> wgpu::ComputePass<'a> {
        let mut recorder = lock(&self.timeline.0);
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
