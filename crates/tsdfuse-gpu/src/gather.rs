//! Downloading chosen blocks of a map.

use tsdfuse::{
    index::{BLOCK_VOXELS, BlockIndex},
    map::Block,
};
use wgpu::BufferUsages as Usage;

use crate::error::GpuError;
use crate::map::{BATCH, DeviceMap, block_of};
use crate::shader::{Binding, GATHER, source};

/// In the kernel's output: whether the map has the block, and its voxels.
const BLOCK_BYTES: usize = 4 + 8 * BLOCK_VOXELS;

impl DeviceMap {
    /// Downloads blocks, in the given order. Blocks that the map does not have are left out.
    ///
    /// A copy of the map follows the device if it replaces the [`updated_blocks`](crate::Fused::updated_blocks) of each scan
    /// that is reported. The downloaded blocks may already contain scans that are still in flight; those report them again.
    ///
    /// # Errors
    /// [`GpuError::Lost`] if the device is gone, [`GpuError::OutOfMemory`] if it has no memory for the copies.
    pub fn download_blocks(&self, indices: &[BlockIndex]) -> Result<Vec<(BlockIndex, Block)>, GpuError> {
        let mut blocks = Vec::with_capacity(indices.len());
        for batch in indices.chunks(BATCH as usize) {
            self.gather(batch, &mut blocks)?;
        }
        Ok(blocks)
    }

    fn gather(&self, indices: &[BlockIndex], blocks: &mut Vec<(BlockIndex, Block)>) -> Result<(), GpuError> {
        let gpu = &self.gpu;
        let (layout, kernel) = self.gather.get_or_init(|| {
            let layout = gpu.layout([Binding::Read, Binding::Storage]);
            let kernel = gpu.kernel(&source(self.paging, &[GATHER]), "gather", &[&self.layout, &layout]);
            (layout, kernel)
        });
        let list: Vec<[i32; 4]> = indices.iter().map(|index| index.0.extend(0).to_array()).collect();
        let usage = Usage::STORAGE | Usage::COPY_DST;
        let wanted = gpu.buffer("a list of blocks", 16 * list.len() as u64, usage)?;
        gpu.queue.write_buffer(&wanted, 0, bytemuck::cast_slice(&list));
        let usage = Usage::STORAGE | Usage::COPY_SRC;
        let collected = gpu.buffer("copies of blocks", (BLOCK_BYTES * list.len()) as u64, usage)?;
        let bound = [&wanted, &collected].map(wgpu::Buffer::as_entire_binding);
        let group = gpu.bind(layout, bound);
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        let mut pass = gpu.pass(&mut encoder, "gather");
        pass.set_pipeline(kernel);
        pass.set_bind_group(0, &self.bind_group, &[]);
        pass.set_bind_group(1, &group, &[]);
        pass.dispatch_workgroups(list.len() as u32, 1, 1);
        drop(pass);
        gpu.queue.submit([encoder.finish()]);
        gpu.read_with(&collected, 0, collected.size(), |bytes| {
            let parts = indices.iter().zip(bytes.chunks_exact(BLOCK_BYTES));
            let present = parts.filter(|(_, bytes)| bytes[..4] != [0; 4]);
            blocks.extend(present.map(|(&index, bytes)| (index, block_of(&bytes[4..]))));
        })
    }
}
