//! Buffers that the kernels of one scan leave to those after them: used scan after scan, since scans come one after the other there.

use std::ops::Range;

use wgpu::BufferUsages as Usage;

use crate::device::Gpu;
use crate::error::GpuError;

/// Cells, places, offers, rings (`shaders/image.wgsl`); patches, noise (`shaders/planes.wgsl`). Or, of other images, where returns are
/// seen, pixels, and one ring, as the second to the fourth.
#[derive(Clone, Debug, Default)]
pub(crate) struct Scratch(Vec<wgpu::Buffer>);

/// What kernels bind where a method needs none.
const LEAST_BYTES: u64 = 64;

impl Scratch {
    /// How many there are.
    pub(crate) const BUFFERS: usize = 6;
    /// Those whose contents are of one scan alone.
    pub(crate) const CLEARED: Range<usize> = 2..4;

    /// Makes room for a scan that needs so many bytes of each. Scans under way keep those that they have a clone of.
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

    /// Forgets what was counted and offered.
    pub(crate) fn clear(&self, encoder: &mut wgpu::CommandEncoder) {
        self.0[Self::CLEARED]
            .iter()
            .for_each(|buffer| encoder.clear_buffer(buffer, 0, None));
    }

    pub(crate) fn buffers(&self) -> &[wgpu::Buffer] {
        &self.0
    }
}
