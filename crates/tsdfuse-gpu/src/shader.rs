//! The sources of the kernels, assembled from WGSL files and a generated part that depends on the pages of the pool.

use std::fmt::Write as _;

use crate::device::Gpu;

/// How the voxels of a map are split into buffers, since the size of a binding is limited.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Paging {
    /// The number of buffers that kernels bind.
    pub(crate) pages: u32,
    /// Each buffer holds two to this power blocks.
    pub(crate) shift: u32,
}

impl Paging {
    /// Blocks per page.
    pub(crate) fn blocks(self) -> u32 {
        1 << self.shift
    }

    /// Blocks in all pages.
    pub(crate) fn most_blocks(self) -> u32 {
        self.pages << self.shift
    }

    /// The bindings of the pages, and functions that access voxels by slot and number. The slot must exist.
    fn pool(self) -> String {
        let mut text = String::from("// One binding a page: weight sum and distance sum of each voxel in turn.\n");
        let mask = self.blocks() - 1;
        let place = format!("    let at = 2u * ((slot & {mask}u) * BLOCK_VOXELS + local);\n");
        let all = |text: &mut String, head: &str, case: &dyn Fn(u32) -> String, end: &str| {
            let _ = writeln!(text, "fn {head} {{\n{place}    switch slot >> {}u {{", self.shift);
            for page in 0..self.pages {
                let _ = writeln!(text, "        case {page}u: {{ {} }}", case(page));
            }
            let _ = writeln!(text, "        default: {{ {end} }}\n    }}\n}}");
        };
        for page in 0..self.pages {
            let binding = FIRST_PAGE + page;
            let _ = writeln!(
                text,
                "@group(0) @binding({binding}) var<storage, read_write> pool{page}: array<atomic<u32>>;"
            );
        }
        // Returns the previous weight.
        all(
            &mut text,
            "add_to_voxel(slot: u32, local: u32, weight: u32, distance: u32) -> u32",
            &|p| format!("atomicAdd(&pool{p}[at + 1u], distance); return atomicAdd(&pool{p}[at], weight);"),
            "return 0u;",
        );
        all(
            &mut text,
            "load_voxel(slot: u32, local: u32) -> vec2<u32>",
            &|p| format!("return vec2(atomicLoad(&pool{p}[at]), atomicLoad(&pool{p}[at + 1u]));"),
            "return vec2(0u);",
        );
        all(
            &mut text,
            "store_voxel(slot: u32, local: u32, voxel: vec2<u32>)",
            &|p| format!("atomicStore(&pool{p}[at], voxel.x); atomicStore(&pool{p}[at + 1u], voxel.y);"),
            "",
        );
        text
    }
}

/// The binding of the first page; table, blocks and state come before it.
pub(crate) const FIRST_PAGE: u32 = 3;

/// The source of a kernel: the map, and these parts.
pub(crate) fn source(paging: Paging, parts: &[&str]) -> String {
    let mut text = [MAP, &paging.pool()].join("\n");
    for part in parts {
        text.push('\n');
        text.push_str(part);
    }
    text
}

const MAP: &str = include_str!("shaders/map.wgsl");
pub(crate) const FRAME: &str = include_str!("shaders/frame.wgsl");
pub(crate) const KEEP: &str = include_str!("shaders/keep.wgsl");
pub(crate) const GATHER: &str = include_str!("shaders/gather.wgsl");
pub(crate) const LINES: &str = include_str!("shaders/lines.wgsl");
pub(crate) const RAYCAST: &str = include_str!("shaders/raycast.wgsl");
pub(crate) const EUCLIDEAN: &str = include_str!("shaders/euclidean.wgsl");
pub(crate) const PROJECTIVE: &str = include_str!("shaders/projective.wgsl");

pub(crate) const SURFACE: &str = include_str!("shaders/surface.wgsl");
pub(crate) const FIND_SURFACE: &str = include_str!("shaders/find_surface.wgsl");
pub(crate) const WRITE_MESH: &str = include_str!("shaders/write_mesh.wgsl");

pub(crate) const ANGLES: &str = include_str!("shaders/angles.wgsl");
pub(crate) const CYLINDER: &str = include_str!("shaders/cylinder.wgsl");
pub(crate) const ONE_LINE: &str = include_str!("shaders/one_line.wgsl");
pub(crate) const NORMALS: &str = include_str!("shaders/normals.wgsl");

pub(crate) const PHASES: &str = include_str!("shaders/phases.wgsl");
pub(crate) const IMAGE: &str = include_str!("shaders/image.wgsl");
pub(crate) const PLANES: &str = include_str!("shaders/planes.wgsl");
pub(crate) const PATCH: &str = include_str!("shaders/patch.wgsl");
pub(crate) const AGREEMENT: &str = include_str!("shaders/agreement.wgsl");
pub(crate) const SETTLED: &str = include_str!("shaders/settled.wgsl");
pub(crate) const CARVE: &str = include_str!("shaders/carve.wgsl");

pub(crate) const RENDER: &str = include_str!("shaders/render.wgsl");

pub(crate) const PIXELS: &str = include_str!("shaders/pixels.wgsl");
pub(crate) const CYLINDRICAL: &str = include_str!("shaders/cylindrical.wgsl");
pub(crate) const DEPTH: &str = include_str!("shaders/depth.wgsl");

/// The kind of a binding.
#[derive(Clone, Copy)]
pub(crate) enum Binding {
    /// A storage buffer that kernels write to.
    Storage,
    /// A storage buffer that kernels only read.
    Read,
    /// A uniform of this many bytes; each dispatch sets its offset.
    Uniform(u64),
}

impl Gpu {
    /// The layout of a group of bindings, numbered from 0.
    pub(crate) fn layout(&self, bindings: impl IntoIterator<Item = Binding>) -> wgpu::BindGroupLayout {
        let entry = |(binding, kind): (u32, Binding)| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: match kind {
                Binding::Storage | Binding::Read => wgpu::BindingType::Buffer {
                    ty: wgpu::BufferBindingType::Storage {
                        read_only: matches!(kind, Binding::Read),
                    },
                    has_dynamic_offset: false,
                    min_binding_size: None,
                },
                Binding::Uniform(bytes) => wgpu::BindingType::Buffer {
                    ty: wgpu::BufferBindingType::Uniform,
                    has_dynamic_offset: true,
                    min_binding_size: std::num::NonZeroU64::new(bytes),
                },
            },
            count: None,
        };
        let entries: Vec<_> = (0..).zip(bindings).map(entry).collect();
        self.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: None,
            entries: &entries,
        })
    }

    /// A group of bindings, numbered from 0.
    pub(crate) fn bind<'a>(
        &self,
        layout: &wgpu::BindGroupLayout,
        resources: impl IntoIterator<Item = wgpu::BindingResource<'a>>,
    ) -> wgpu::BindGroup {
        let entry = |(binding, resource)| wgpu::BindGroupEntry { binding, resource };
        let entries: Vec<_> = (0..).zip(resources).map(entry).collect();
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout,
            entries: &entries,
        })
    }

    /// Compiles a kernel.
    pub(crate) fn kernel(&self, source: &str, entry: &str, groups: &[&wgpu::BindGroupLayout]) -> wgpu::ComputePipeline {
        let module = self.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(entry),
            source: wgpu::ShaderSource::Wgsl(source.into()),
        });
        let groups: Vec<_> = groups.iter().map(|g| Some(*g)).collect();
        let layout = self.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: &groups,
            immediate_size: 0,
        });
        self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(entry),
            layout: Some(&layout),
            module: &module,
            entry_point: Some(entry),
            compilation_options: Default::default(),
            cache: None,
        })
    }
}
