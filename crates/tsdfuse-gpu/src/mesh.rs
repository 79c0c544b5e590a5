//! Extracting meshes on the device: marching cubes with shared vertices, like [`tsdfuse::mesh`].
//!
//! ```text
//!   find_surface   one workgroup per block: rows of edges and cells, counts of vertices and triangles ─▶ host
//!   host           sorts the blocks with surface, adds up the counts                                  ─▶ device
//!   write_mesh     one workgroup per block with surface: vertices, normals, triangles                 ─▶ host
//! ```
//!
//! The host reads back 24 bytes per block of the map, then the mesh. Blocks have the same order as on the CPU, so the mesh has
//! the same triangles; positions and normals differ by the rounding of f32.

use rayon::prelude::*;
use tsdfuse::{
    Mesh,
    glam::{DVec3, Vec3},
    index::BlockIndex,
    mesh::{MeshConfig, MeshError},
};
use wgpu::BufferUsages as Usage;

use crate::error::GpuError;
use crate::map::DeviceMap;
use crate::shader::{Binding, SURFACE, WRITE_MESH, source};
use crate::surface::{BINDINGS, Finder, Params, WORKGROUPS};

/// Extracts meshes from maps on the device; reuses its buffers.
#[derive(Debug)]
pub struct Mesher {
    finder: Finder,
    kernel: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
}

/// A block with surface.
struct Item {
    index: BlockIndex,
    slot: u32,
    vertices: u32,
    triangles: u32,
    first_vertex: u64,
    first_triangle: u64,
}

const VERTEX_BYTES: u64 = 24;
const TRIANGLE_BYTES: u64 = 12;

impl Mesher {
    /// Prepares the extraction from this map.
    ///
    /// # Errors
    /// [`GpuError`] if the device cannot run the kernels.
    pub fn new(map: &DeviceMap) -> Result<Self, GpuError> {
        let gpu = &map.gpu;
        let more = [Binding::Read, Binding::Read, Binding::Storage, Binding::Storage];
        let layout = gpu.layout(BINDINGS.into_iter().chain(more));
        let kernel = source(map.paging, &[SURFACE, WRITE_MESH]);
        let mesher = Self {
            finder: Finder::new(map)?,
            kernel: gpu.kernel(&kernel, "write_mesh", &[&map.layout, &layout]),
            layout,
        };
        gpu.check()?;
        Ok(mesher)
    }

    /// The surface of the map: the triangles of [`tsdfuse::mesh::extract_with`], in the same order.
    ///
    /// # Errors
    /// [`GpuError::Mesh`] if the mesh has too many vertices; otherwise errors of the device.
    pub fn extract(&mut self, map: &DeviceMap, config: &MeshConfig) -> Result<Mesh, GpuError> {
        config.validate()?;
        let min_sum = config.min_weight_sum().cast_unsigned();
        let blocks = self.finder.find(map, min_sum)?;
        let items = self.items(map, blocks)?;
        let Some(last) = items.last() else {
            return Ok(Mesh::default());
        };
        let vertices = last.first_vertex + u64::from(last.vertices);
        if vertices > u64::from(u32::MAX) {
            return Err(MeshError::TooManyVertices(vertices).into());
        }
        let mut mesh = Mesh::default();
        let (list, firsts) = self.upload(map, &items)?;
        let params = Params {
            blocks,
            min_sum,
            ..Params::default()
        };
        let mut first = 0;
        while first < items.len() {
            let count = self.batch(map, &items[first..]);
            self.write(
                map,
                &items[first..first + count],
                Params {
                    first: first as u32,
                    ..params
                },
                [&list, &firsts],
                &mut mesh,
            )?;
            first += count;
        }
        Ok(mesh)
    }

    /// The blocks with surface, sorted, with the start of their parts of the mesh.
    fn items(&self, map: &DeviceMap, blocks: u32) -> Result<Vec<Item>, GpuError> {
        let counts = self.finder.counts(&map.gpu, blocks)?;
        let indices = map.indices(blocks)?;
        let with_surface = (0..)
            .zip(counts)
            .zip(indices)
            .filter(|((_, counts), _)| *counts != [0; 2]);
        let item = |((slot, [vertices, triangles]), index): ((u32, [u32; 2]), BlockIndex)| Item {
            index,
            slot,
            vertices,
            triangles,
            first_vertex: 0,
            first_triangle: 0,
        };
        let mut items: Vec<Item> = with_surface.map(item).collect();
        items.par_sort_unstable_by_key(|item| item.index);
        let (mut vertices, mut triangles) = (0, 0);
        for item in &mut items {
            (item.first_vertex, item.first_triangle) = (vertices, triangles);
            vertices += u64::from(item.vertices);
            triangles += u64::from(item.triangles);
        }
        Ok(items)
    }

    /// Uploads the list of blocks, and the first vertex of each by slot. (The numbers of vertices, and of triangles within a
    /// batch, fit into 32 bits.)
    fn upload(&self, map: &DeviceMap, items: &[Item]) -> Result<(wgpu::Buffer, wgpu::Buffer), GpuError> {
        let gpu = &map.gpu;
        let listed: Vec<[u32; 4]> = items
            .iter()
            .map(|i| [i.slot, i.first_vertex as u32, i.first_triangle as u32, 0])
            .collect();
        let mut by_slot = vec![0_u32; map.capacity() as usize];
        items
            .iter()
            .for_each(|i| by_slot[i.slot as usize] = i.first_vertex as u32);
        let usage = Usage::STORAGE | Usage::COPY_DST;
        let list = gpu.buffer("the list of surface blocks", 16 * items.len() as u64, usage)?;
        let firsts = gpu.buffer("first vertices", 4 * by_slot.len() as u64, usage)?;
        gpu.queue.write_buffer(&list, 0, bytemuck::cast_slice(&listed));
        gpu.queue.write_buffer(&firsts, 0, bytemuck::cast_slice(&by_slot));
        Ok((list, firsts))
    }

    /// How many of the blocks fit, with their parts of the mesh, into one binding.
    fn batch(&self, map: &DeviceMap, items: &[Item]) -> usize {
        let limit = map.gpu.binding_limit();
        let fits = |item: &&Item| {
            let vertices = item.first_vertex + u64::from(item.vertices) - items[0].first_vertex;
            let triangles = item.first_triangle + u64::from(item.triangles) - items[0].first_triangle;
            vertices * VERTEX_BYTES <= limit && triangles * TRIANGLE_BYTES <= limit
        };
        items.iter().take_while(fits).count().max(1)
    }

    /// Extracts the part of the mesh that belongs to some blocks.
    fn write(
        &self,
        map: &DeviceMap,
        items: &[Item],
        params: Params,
        lists: [&wgpu::Buffer; 2],
        mesh: &mut Mesh,
    ) -> Result<(), GpuError> {
        let gpu = &map.gpu;
        let vertices: u64 = items.iter().map(|i| u64::from(i.vertices)).sum();
        let triangles: u64 = items.iter().map(|i| u64::from(i.triangles)).sum();
        let usage = Usage::STORAGE | Usage::COPY_SRC;
        let out = [
            gpu.buffer("vertices", (vertices * VERTEX_BYTES).max(4), usage)?,
            gpu.buffer("triangles", (triangles * TRIANGLE_BYTES).max(4), usage)?,
        ];
        self.finder.tell(
            gpu,
            &Params {
                count: items.len() as u32,
                first_vertex: items[0].first_vertex as u32,
                first_triangle: items[0].first_triangle as u32,
                ..params
            },
        );
        let more = lists.into_iter().chain(&out).map(wgpu::Buffer::as_entire_binding);
        let group = gpu.bind(&self.layout, self.finder.resources().chain(more));
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        let mut pass = gpu.pass(&mut encoder, "write_mesh");
        pass.set_pipeline(&self.kernel);
        pass.set_bind_group(0, &map.bind_group, &[]);
        pass.set_bind_group(1, &group, &[0]);
        pass.dispatch_workgroups((items.len() as u32).min(WORKGROUPS), 1, 1);
        drop(pass);
        gpu.queue.submit([encoder.finish()]);

        let grid = map.empty.grid();
        let size = map.config().voxel_size_m;
        let origins = items.iter().flat_map(|item| {
            let origin = grid.center(item.index.first_voxel());
            std::iter::repeat_n(origin, item.vertices as usize)
        });
        let origins: Vec<DVec3> = origins.collect();
        let vec3 = |bytes: &[u8]| bytemuck::pod_read_unaligned::<Vec3>(bytes);
        gpu.read_with(&out[0], 0, vertices * VERTEX_BYTES, |bytes| {
            let numbers = bytes.par_chunks_exact(VERTEX_BYTES as usize);
            let placed = numbers.clone().zip(&origins);
            mesh.vertices
                .par_extend(placed.map(|(bytes, origin)| *origin + vec3(&bytes[..12]).as_dvec3() * size));
            mesh.normals.par_extend(numbers.map(|bytes| vec3(&bytes[12..])));
        })?;
        gpu.read_with(&out[1], 0, triangles * TRIANGLE_BYTES, |bytes| {
            let numbers = bytes.par_chunks_exact(TRIANGLE_BYTES as usize);
            mesh.triangles
                .par_extend(numbers.map(bytemuck::pod_read_unaligned::<[u32; 3]>));
        })?;
        Ok(())
    }
}
