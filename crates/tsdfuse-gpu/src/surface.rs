//! Finding the surface, the first step of meshing and rendering (`shaders/surface.wgsl`).

use bytemuck::{Pod, Zeroable};
use tsdfuse::mesh::cube_triangles;
use wgpu::BufferUsages as Usage;

use crate::device::Gpu;
use crate::error::GpuError;
use crate::map::DeviceMap;
use crate::shader::{Binding, FIND_SURFACE, SURFACE, source};

/// The parameters of the kernels: `Surface` in the shaders.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Params {
    pub(crate) blocks: u32,
    pub(crate) min_sum: u32,
    pub(crate) first: u32,
    pub(crate) count: u32,
    pub(crate) first_vertex: u32,
    pub(crate) first_triangle: u32,
}

/// Bindings 0 … 4 of the shaders' group 1.
pub(crate) const BINDINGS: [Binding; 5] = [
    Binding::Uniform(size_of::<Params>() as u64),
    Binding::Storage,
    Binding::Storage,
    Binding::Storage,
    Binding::Read,
];

/// Finds the surface, and holds the result.
#[derive(Debug)]
pub(crate) struct Finder {
    kernel: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
    params: wgpu::Buffer,
    cases: wgpu::Buffer,
    /// The result has room for this many blocks.
    capacity: u32,
    found: Option<[wgpu::Buffer; 3]>,
}

/// The most workgroups; each loops over blocks.
pub(crate) const WORKGROUPS: u32 = 4096;

const NEIGHBOURS_BYTES: u64 = 4 * 27;
const ROWS_BYTES: u64 = 4 * 64;
const COUNTS_BYTES: u64 = 8;

impl Finder {
    /// Prepares the search, for maps with the same pages as this one.
    pub(crate) fn new(map: &DeviceMap) -> Result<Self, GpuError> {
        let gpu = &map.gpu;
        let layout = gpu.layout(BINDINGS);
        let kernel = source(map.paging, &[SURFACE, FIND_SURFACE]);
        let cases: Vec<u8> = (0..256).flat_map(case).flat_map(u32::to_le_bytes).collect();
        let finder = Self {
            kernel: gpu.kernel(&kernel, "find_surface", &[&map.layout, &layout]),
            layout,
            params: gpu.buffer(
                "parameters",
                size_of::<Params>() as u64,
                Usage::UNIFORM | Usage::COPY_DST,
            )?,
            cases: gpu.buffer("cases", cases.len() as u64, Usage::STORAGE | Usage::COPY_DST)?,
            capacity: 0,
            found: None,
        };
        gpu.queue.write_buffer(&finder.cases, 0, &cases);
        gpu.check()?;
        Ok(finder)
    }

    /// Finds the surface between voxels of at least this weight sum; returns the number of blocks of the map.
    pub(crate) fn find(&mut self, map: &DeviceMap, min_sum: u32) -> Result<u32, GpuError> {
        let gpu = &map.gpu;
        let blocks = map.block_count()?;
        if self.found.is_none() || self.capacity < blocks {
            self.capacity = map.capacity();
            let of = |what, bytes| gpu.buffer(what, bytes * u64::from(self.capacity), Usage::STORAGE | Usage::COPY_SRC);
            self.found = Some([
                of("neighbours of blocks", NEIGHBOURS_BYTES)?,
                of("surface of blocks", ROWS_BYTES)?,
                of("vertices of blocks", COUNTS_BYTES)?,
            ]);
        }
        self.tell(
            gpu,
            &Params {
                blocks,
                min_sum,
                ..Params::default()
            },
        );
        let group = gpu.bind(&self.layout, self.resources());
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        let mut pass = gpu.pass(&mut encoder, "find_surface");
        pass.set_pipeline(&self.kernel);
        pass.set_bind_group(0, &map.bind_group, &[]);
        pass.set_bind_group(1, &group, &[0]);
        pass.dispatch_workgroups(blocks.min(WORKGROUPS), 1, 1);
        drop(pass);
        gpu.queue.submit([encoder.finish()]);
        Ok(blocks)
    }

    /// Sets the parameters of the kernels that follow.
    pub(crate) fn tell(&self, gpu: &Gpu, params: &Params) {
        gpu.queue.write_buffer(&self.params, 0, bytemuck::bytes_of(params));
    }

    /// The resources of [`BINDINGS`].
    pub(crate) fn resources(&self) -> impl Iterator<Item = wgpu::BindingResource<'_>> {
        let found = self.found.iter().flatten();
        [&self.params]
            .into_iter()
            .chain(found)
            .chain([&self.cases])
            .map(wgpu::Buffer::as_entire_binding)
    }

    /// The numbers of vertices and triangles of each block, by slot.
    pub(crate) fn counts(&self, gpu: &Gpu, blocks: u32) -> Result<Vec<[u32; 2]>, GpuError> {
        match &self.found {
            Some([_, _, counts]) => {
                let bytes = gpu.read(counts, 0, COUNTS_BYTES * u64::from(blocks))?;
                Ok(bytemuck::pod_collect_to_vec(&bytes))
            }
            None => Ok(Vec::new()),
        }
    }
}

/// A case of marching cubes in the kernels' form: the number of triangles, then their edges, four bits each.
fn case(negative: usize) -> [u32; 4] {
    let triangles = cube_triangles(negative);
    let mut words = [triangles.len() as u32, 0, 0, 0];
    for (k, &edge) in triangles.iter().flatten().enumerate() {
        words[1 + k / 8] |= u32::from(edge) << (4 * (k % 8));
    }
    words
}
