//! Buffers through which the kernels of a scan pass data to later ones. All scans share them, since the device processes scans
//! one after another.

use std::ops::Range;

use wgpu::BufferUsages as Usage;

use crate::device::Gpu;
use crate::error::GpuError;

/// For organized images: cells, places, offers, rings (`shaders/image.wgsl`), patches, noise (`shaders/planes.wgsl`). For other
/// images, the second to fourth buffers hold the pixel of each return, the pixels, and one ring.
#[derive(Clone, Debug, Default)]
pub(crate) struct Scratch(Vec<wgpu::Buffer>);

/// The size of buffers that a method does not need but still binds.
const LEAST_BYTES: u64 = 64;

impl Scratch {
    /// The number of buffers.
    pub(crate) const BUFFERS: usize = 6;
    /// The buffers that are cleared for each scan.
    pub(crate) const CLEARED: Range<usize> = 2..4;

    /// Makes room for a scan that needs these sizes, in bytes. Scans in flight keep the buffers that they have clones of.
    pub(crate) fn fit(&mut self, gpu: &Gpu, bytes: &[u64]) -> Result<(), GpuError> {
        for k in 0..Self::BUFFERS {
            let wanted = bytes.get(k).copied().unwrap_or(0).max(LEAST_BYTES);
            if self.0.get(k).is_some_and(|have| have.size() >= wanted) {
                continue;
            }
            let room = wanted.next_power_of_two().min(gpu.binding_limit()).max(wanted);
            let new = gpu.buffer(
                "the image of a scan",
                room,
                Usage::STORAGE | Usage::COPY_SRC | Usage::COPY_DST,
            )?;
            self.0.splice(k..(k + 1).min(self.0.len()), [new]);
        }
        Ok(())
    }

    /// Clears what the scan before has counted and offered.
    pub(crate) fn clear(&self, encoder: &mut wgpu::CommandEncoder) {
        self.0[Self::CLEARED]
            .iter()
            .for_each(|buffer| encoder.clear_buffer(buffer, 0, None));
    }

    pub(crate) fn buffers(&self) -> &[wgpu::Buffer] {
        &self.0
    }
}
