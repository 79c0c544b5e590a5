//! The map on the device: buffers with the same blocks and the same integers as a [`VoxelMap`].
//!
//! ```text
//!   table    4 words per entry: a block's coordinates, its slot + 1               (5.1), open addressing
//!   blocks   4 words per slot:  the block's coordinates, the last scan that updated it
//!   pool     4096 bytes per slot: 512 voxels of two sums; split into pages of one buffer each, since bindings are limited
//!   state    counters (`Header`) and sizes, 13 words, then the list of blocks that the last scan updated
//! ```
//!
//! The device creates blocks in any order, so slots differ from run to run; sums do not, since they are integers. A kernel that
//! finds the table or the pool full sets a flag. From then on kernels do nothing until the host has seen the flag, grown the
//! map, and repeated the scans since. So nothing is lost, and no scan waits for the host.

use std::sync::OnceLock;

use glam::IVec3;
use tsdfuse::{
    MapConfig, VoxelMap,
    index::{BLOCK_VOXELS, BlockIndex},
    map::{Block, Voxel},
};
use wgpu::BufferUsages as Usage;

use crate::device::Gpu;
use crate::error::GpuError;
use crate::shader::{Binding, FIRST_PAGE, FRAME, KEEP, Paging, source};

/// How much memory of the device a map takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PoolConfig {
    /// The initial capacity in blocks; it doubles whenever the map is full.
    pub first_blocks: u32,
    /// Blocks per buffer; rounded down to a power of two and to what a binding of the device holds.
    pub page_blocks: u32,
    /// The most buffers, up to 16. Each slows kernels down: a little on GPUs, a lot on software devices, which run all
    /// branches.
    pub pages: u32,
}

impl Default for PoolConfig {
    fn default() -> Self {
        Self {
            first_blocks: 1 << 14,
            page_blocks: 1 << 18,
            pages: MAX_PAGES,
        }
    }
}

/// A truncated signed distance field on a device.
#[derive(Debug)]
pub struct DeviceMap {
    pub(crate) gpu: Gpu,
    /// An empty map with the same configuration.
    pub(crate) empty: VoxelMap,
    /// The number of scans fused so far: see [`VoxelMap::integrations`].
    pub(crate) integrations: u32,
    pub(crate) paging: Paging,
    pub(crate) layout: wgpu::BindGroupLayout,
    pub(crate) bind_group: wgpu::BindGroup,
    fill_table: wgpu::ComputePipeline,
    /// The kernel of [`DeviceMap::download_blocks`] and the layout of its buffers, compiled when first used.
    pub(crate) gather: OnceLock<(wgpu::BindGroupLayout, wgpu::ComputePipeline)>,
    buffers: Buffers,
}

/// The buffers, which are replaced when the map grows.
#[derive(Clone, Debug)]
struct Buffers {
    /// The capacity in blocks.
    capacity: u32,
    /// Entries of the table, a power of two.
    entries: u32,
    table: wgpu::Buffer,
    blocks: wgpu::Buffer,
    state: wgpu::Buffer,
    pages: Vec<wgpu::Buffer>,
}

/// The first words of the device's state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Header {
    pub(crate) flags: u32,
    pub(crate) blocks: u32,
    pub(crate) updated: u32,
    pub(crate) fused: u32,
    pub(crate) outside_grid: u32,
    pub(crate) without_normal: u32,
    pub(crate) without_weight: u32,
    pub(crate) outside_image: u32,
    pub(crate) hidden: u32,
    pub(crate) lost: u32,
}

impl Header {
    /// Bytes of the counters.
    pub(crate) const BYTES: u64 = 44;
    /// Offset of the counters of the current scan; they end with the header.
    pub(crate) const SCAN: u64 = 8;
    /// Offsets of the table mask and the capacity, and of the list.
    pub(crate) const SIZES: u64 = 44;
    pub(crate) const LIST: u64 = 64;
    /// Bytes of an entry of the list: coordinates and slot.
    pub(crate) const ENTRY: u64 = 16;

    pub(crate) fn parse(bytes: &[u8]) -> Self {
        let word = |i| words(bytes).nth(i).unwrap_or_default();
        Self {
            flags: word(0),
            blocks: word(1),
            updated: word(2),
            fused: word(3),
            outside_grid: word(4),
            without_normal: word(5),
            without_weight: word(6),
            outside_image: word(7),
            hidden: word(8),
            lost: word(9),
        }
    }
}

/// The flag of a full pool. The only other flag is that of a full table.
pub(crate) const POOL_FULL: u32 = 2;

const BLOCK_BYTES: u64 = 8 * BLOCK_VOXELS as u64;
const RECORD_BYTES: u64 = 16;
const ENTRY_BYTES: u64 = 16;

/// The stamp of uploaded blocks, which no scan has for billions of scans. Blocks that no scan has updated have 0.
const LONG_AGO: u32 = u32::MAX;

/// The most pages; each is a binding.
const MAX_PAGES: u32 = 16;
/// Bindings that kernels need beside the pages.
const OTHER_BINDINGS: u32 = 10;

/// How many blocks are copied at once.
pub(crate) const BATCH: u32 = 4096;

impl DeviceMap {
    /// Creates an empty map.
    ///
    /// # Errors
    /// [`GpuError`] if the configuration is invalid or the device has too little memory.
    pub fn new(gpu: &Gpu, config: MapConfig, pool: PoolConfig) -> Result<Self, GpuError> {
        let empty = VoxelMap::new(config)?;
        let page_limit = (gpu.binding_limit() / BLOCK_BYTES)
            .min(u64::from(pool.page_blocks))
            .max(1) as u32;
        let pages = gpu
            .storage_buffers()
            .saturating_sub(OTHER_BINDINGS)
            .min(pool.pages.clamp(1, MAX_PAGES));
        if pages == 0 {
            let few = format!("the GPU binds only {} buffers at once", gpu.storage_buffers());
            return Err(GpuError::Unsupported(few));
        }
        let paging = Paging {
            pages,
            shift: page_limit.ilog2(),
        };
        let layout = gpu.layout((0..FIRST_PAGE + pages).map(|_| Binding::Storage));
        let capacity = pool.first_blocks.clamp(1, paging.most_blocks());
        let buffers = Buffers::new(gpu, paging, capacity, entries_for(capacity))?;
        let fill_table = gpu.kernel(&source(paging, &[FRAME, KEEP]), "fill_table", &[&layout]);
        let map = Self {
            gpu: gpu.clone(),
            empty,
            integrations: 0,
            paging,
            bind_group: buffers.bind(gpu, &layout, paging)?,
            layout,
            fill_table,
            gather: OnceLock::new(),
            buffers,
        };
        map.write_sizes();
        gpu.check()?;
        Ok(map)
    }

    /// Copies a map to the device.
    ///
    /// # Errors
    /// [`GpuError`] if the device has too little memory for it.
    pub fn upload(gpu: &Gpu, map: &VoxelMap, pool: PoolConfig) -> Result<Self, GpuError> {
        let indices = map.block_indices();
        let count = u32::try_from(indices.len()).unwrap_or(u32::MAX);
        let mut device = Self::new(gpu, *map.config(), pool)?;
        device.integrations = map.integrations();
        if count > device.buffers.capacity {
            device.grow_pool(count, 0)?;
        }
        for (first, indices) in (0..).step_by(BATCH as usize).zip(indices.chunks(BATCH as usize)) {
            let records = indices
                .iter()
                .flat_map(|b| b.0.to_array().map(i32::cast_unsigned).into_iter().chain([LONG_AGO]));
            device.write(&device.buffers.blocks, RECORD_BYTES * u64::from(first), records);
            for (slot, &index) in (first..).zip(indices) {
                let voxels = map.block(index).into_iter().flat_map(|b| &b.voxels);
                let sums = voxels.flat_map(|v| [v.weight_sum, v.distance_sum.cast_unsigned()]);
                let (page, at) = device.place(slot);
                device.write(page, at, sums);
            }
            device.gpu.queue.submit([]);
            device.gpu.wait(None)?;
        }
        device.write(&device.buffers.state, 4, [count]);
        device.fill_table()?;
        Ok(device)
    }

    /// Copies the map back from the device.
    ///
    /// # Errors
    /// [`GpuError::Lost`] if the device is gone.
    pub fn download(&self) -> Result<VoxelMap, GpuError> {
        let mut map = VoxelMap::new(*self.config())?;
        map.set_integrations(self.integrations);
        let count = self.block_count()?;
        let mut first = 0;
        while first < count {
            // A batch must not cross the end of a page.
            let page_end = (first / self.paging.blocks() + 1) * self.paging.blocks();
            let last = count.min(first + BATCH).min(page_end);
            self.download_some(first, last, &mut map)?;
            first = last;
        }
        Ok(map)
    }

    fn download_some(&self, first: u32, last: u32, map: &mut VoxelMap) -> Result<(), GpuError> {
        let count = u64::from(last - first);
        let records = self.gpu.read(
            &self.buffers.blocks,
            RECORD_BYTES * u64::from(first),
            RECORD_BYTES * count,
        )?;
        let (page, at) = self.place(first);
        let voxels = self.gpu.read(page, at, BLOCK_BYTES * count)?;
        let blocks = voxels.chunks_exact(BLOCK_BYTES as usize);
        for (record, voxels) in records.chunks_exact(RECORD_BYTES as usize).zip(blocks) {
            // A block that no scan updated was created by a scan that did not fit.
            if words(record).nth(3) != Some(0) {
                map.insert_block(index_of(record), block_of(voxels))?;
            }
        }
        Ok(())
    }

    /// The map's configuration.
    pub fn config(&self) -> &MapConfig {
        self.empty.config()
    }

    /// The number of blocks.
    ///
    /// # Errors
    /// [`GpuError::Lost`] if the device is gone.
    pub fn block_count(&self) -> Result<u32, GpuError> {
        Ok(self.header()?.blocks.min(self.buffers.capacity))
    }

    /// The indices of all blocks, by slot.
    pub(crate) fn indices(&self, blocks: u32) -> Result<Vec<BlockIndex>, GpuError> {
        let records = self
            .gpu
            .read(&self.buffers.blocks, 0, RECORD_BYTES * u64::from(blocks))?;
        Ok(records.chunks_exact(RECORD_BYTES as usize).map(index_of).collect())
    }

    /// How many blocks fit before the map has to grow.
    pub fn capacity(&self) -> u32 {
        self.buffers.capacity
    }

    /// The size of all buffers of the map, in bytes.
    pub fn memory_bytes(&self) -> u64 {
        let b = &self.buffers;
        [&b.table, &b.blocks, &b.state]
            .into_iter()
            .chain(&b.pages)
            .map(wgpu::Buffer::size)
            .sum()
    }

    /// The buffer that holds the map's counters.
    pub(crate) fn state(&self) -> &wgpu::Buffer {
        &self.buffers.state
    }

    fn header(&self) -> Result<Header, GpuError> {
        let bytes = self.gpu.read(&self.buffers.state, 0, Header::BYTES)?;
        Ok(Header::parse(&bytes))
    }

    /// Grows the map after a kernel found it full, so that the scan can be repeated. No kernel may be running. On failure the map
    /// is as before, and kernels continue to do nothing.
    pub(crate) fn make_room(&mut self, header: Header) -> Result<(), GpuError> {
        let blocks = u64::from(self.buffers.capacity);
        let grown = if header.flags & POOL_FULL == 0 {
            self.grow_table()
        } else {
            self.grow_pool(header.blocks, header.blocks.min(self.buffers.capacity))
        };
        grown.map_err(|error| match error {
            // A buffer of the larger map would exceed what the device can bind.
            GpuError::TooLarge { .. } => GpuError::TooManyBlocks { blocks },
            other => other,
        })
    }

    /// Grows the pool to at least `wanted` blocks, `have` of which exist.
    fn grow_pool(&mut self, wanted: u32, have: u32) -> Result<(), GpuError> {
        let most = self.paging.most_blocks();
        if wanted > most || self.buffers.capacity == most {
            return Err(GpuError::TooManyBlocks { blocks: most.into() });
        }
        let capacity = self.buffers.capacity.saturating_mul(2).max(wanted).min(most);
        // Whole pages beyond the first one.
        let page = self.paging.blocks();
        let capacity = if capacity > page {
            capacity.div_ceil(page) * page
        } else {
            capacity
        };
        self.buffers = self.buffers.grown(&self.gpu, self.paging, capacity)?;
        self.rebind()?;
        self.write(&self.buffers.state, 0, [0, have]);
        self.fill_table()
    }

    /// Doubles the table.
    fn grow_table(&mut self) -> Result<(), GpuError> {
        let entries = self.buffers.entries.saturating_mul(2);
        self.buffers.table = new_table(&self.gpu, entries)?;
        self.buffers.entries = entries;
        self.rebind()?;
        self.write(&self.buffers.state, 0, [0]);
        self.fill_table()
    }

    fn rebind(&mut self) -> Result<(), GpuError> {
        self.bind_group = self.buffers.bind(&self.gpu, &self.layout, self.paging)?;
        self.write_sizes();
        Ok(())
    }

    /// Enters all blocks into an empty table, and into larger ones until all of them fit.
    fn fill_table(&mut self) -> Result<(), GpuError> {
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        let mut pass = self.gpu.pass(&mut encoder, "fill_table");
        pass.set_pipeline(&self.fill_table);
        pass.set_bind_group(0, &self.bind_group, &[]);
        pass.dispatch_workgroups(self.buffers.capacity.div_ceil(64).min(1024), 1, 1);
        drop(pass);
        self.gpu.queue.submit([encoder.finish()]);
        match self.header()?.flags {
            0 => Ok(()),
            _ => self.grow_table(),
        }
    }

    fn write_sizes(&self) {
        let Buffers { entries, capacity, .. } = self.buffers;
        self.write(&self.buffers.state, Header::SIZES, [entries - 1, capacity]);
    }

    fn write(&self, buffer: &wgpu::Buffer, at: u64, words: impl IntoIterator<Item = u32>) {
        let bytes: Vec<u8> = words.into_iter().flat_map(u32::to_le_bytes).collect();
        self.gpu.queue.write_buffer(buffer, at, &bytes);
    }

    /// The page of a slot, and the offset of the slot's voxels in it.
    fn place(&self, slot: u32) -> (&wgpu::Buffer, u64) {
        let (page, at) = (slot / self.paging.blocks(), slot % self.paging.blocks());
        (&self.buffers.pages[page as usize], BLOCK_BYTES * u64::from(at))
    }
}

impl Buffers {
    fn new(gpu: &Gpu, paging: Paging, capacity: u32, entries: u32) -> Result<Self, GpuError> {
        let pages = (0..capacity.div_ceil(paging.blocks())).map(|page| {
            let blocks = (capacity - page * paging.blocks()).min(paging.blocks());
            gpu.buffer("voxels", BLOCK_BYTES * u64::from(blocks), STORED)
        });
        Ok(Self {
            capacity,
            entries,
            table: new_table(gpu, entries)?,
            blocks: gpu.buffer("the list of blocks", RECORD_BYTES * u64::from(capacity), STORED)?,
            state: gpu.buffer(
                "the map's state",
                Header::LIST + Header::ENTRY * u64::from(capacity),
                STORED,
            )?,
            pages: pages.collect::<Result<_, _>>()?,
        })
    }

    /// The same blocks with a larger capacity and an empty table. Full pages are kept, not copied.
    fn grown(&self, gpu: &Gpu, paging: Paging, capacity: u32) -> Result<Self, GpuError> {
        let mut grown = Self {
            pages: Vec::new(),
            capacity,
            entries: entries_for(capacity).max(self.entries),
            table: new_table(gpu, entries_for(capacity).max(self.entries))?,
            blocks: gpu.buffer("the list of blocks", RECORD_BYTES * u64::from(capacity), STORED)?,
            state: gpu.buffer(
                "the map's state",
                Header::LIST + Header::ENTRY * u64::from(capacity),
                STORED,
            )?,
        };
        let mut copies = vec![(&self.blocks, grown.blocks.clone()), (&self.state, grown.state.clone())];
        for page in 0..capacity.div_ceil(paging.blocks()) {
            let blocks = (capacity - page * paging.blocks()).min(paging.blocks());
            let bytes = BLOCK_BYTES * u64::from(blocks);
            let old = self.pages.get(page as usize);
            if let Some(same) = old.filter(|old| old.size() == bytes) {
                grown.pages.push(same.clone());
                continue;
            }
            let new = gpu.buffer("voxels", bytes, STORED)?;
            copies.extend(old.map(|old| (old, new.clone())));
            grown.pages.push(new);
        }
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        for (from, to) in &copies {
            encoder.copy_buffer_to_buffer(from, 0, to, 0, from.size());
        }
        gpu.queue.submit([encoder.finish()]);
        gpu.check()?;
        Ok(grown)
    }

    fn bind(&self, gpu: &Gpu, layout: &wgpu::BindGroupLayout, paging: Paging) -> Result<wgpu::BindGroup, GpuError> {
        let absent = (self.pages.len()..paging.pages as usize).map(|_| gpu.buffer("no voxels", 4, STORED));
        let absent = absent.collect::<Result<Vec<_>, _>>()?;
        let own = [&self.table, &self.blocks, &self.state].into_iter().chain(&self.pages);
        Ok(gpu.bind(layout, own.chain(&absent).map(wgpu::Buffer::as_entire_binding)))
    }
}

const STORED: Usage = Usage::STORAGE.union(Usage::COPY_SRC).union(Usage::COPY_DST);

/// At most half of the table is used, so that look-ups take few steps.
fn entries_for(capacity: u32) -> u32 {
    capacity.saturating_mul(2).next_power_of_two().max(64)
}

fn new_table(gpu: &Gpu, entries: u32) -> Result<wgpu::Buffer, GpuError> {
    gpu.buffer("the block table", ENTRY_BYTES * u64::from(entries), STORED)
}

pub(crate) fn words(bytes: &[u8]) -> impl Iterator<Item = u32> {
    bytes.as_chunks().0.iter().map(|b| u32::from_le_bytes(*b))
}

/// The block with these sums.
pub(crate) fn block_of(voxels: &[u8]) -> Block {
    let mut block = Block {
        voxels: [Voxel::default(); BLOCK_VOXELS],
    };
    let mut sums = words(voxels);
    for voxel in &mut block.voxels {
        if let (Some(weight_sum), Some(distance_sum)) = (sums.next(), sums.next()) {
            *voxel = Voxel {
                weight_sum,
                distance_sum: distance_sum.cast_signed(),
            };
        }
    }
    block
}

/// The index of the block that a record describes.
pub(crate) fn index_of(record: &[u8]) -> BlockIndex {
    let mut coordinates = words(record).map(u32::cast_signed);
    let mut next = || coordinates.next().unwrap_or_default();
    BlockIndex(IVec3::new(next(), next(), next()))
}
