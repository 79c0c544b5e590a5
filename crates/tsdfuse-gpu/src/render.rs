//! Rendering views on the device: the first surface that the ray of each pixel hits, like [`tsdfuse::render`].
//!
//! The CPU computes the rays of a camera once, in the camera's own axes; a view then only needs a pose.
//! Ranges are f32: at 10⁶ voxels they are exact to 1/16 voxel.

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;
use tsdfuse::{
    Pose,
    glam::{DMat3, IVec3, Vec3},
    mesh::MeshConfig,
    render::{Camera, Hit, RenderConfig, RenderError, View},
};
use wgpu::BufferUsages as Usage;

use crate::device::Gpu;
use crate::error::GpuError;
use crate::map::DeviceMap;
use crate::shader::{Binding, RENDER, SURFACE, source};
use crate::surface::{BINDINGS, Finder};

/// Renders views of a map on the device.
#[derive(Debug)]
pub struct Renderer {
    finder: Finder,
    kernel: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
    params: wgpu::Buffer,
    config: RenderConfig,
    /// The lowest and the highest corner of the blocks with surface.
    span: Option<(IVec3, IVec3)>,
    image: Option<Image>,
}

/// A camera, the rays of its pixels, and what they hit.
#[derive(Debug)]
struct Image {
    camera: Camera,
    rays: wgpu::Buffer,
    hits: wgpu::Buffer,
}

/// The parameters of the kernel: `View` in the shader.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Params {
    pub(crate) base: [i32; 3],
    pub(crate) width: u32,
    pub(crate) origin: [f32; 3],
    pub(crate) height: u32,
    pub(crate) world_x: [f32; 3],
    pub(crate) max_range_vox: f32,
    pub(crate) world_y: [f32; 3],
    pub(crate) voxel_size_m: f32,
    pub(crate) world_z: [f32; 3],
    pub(crate) pad: u32,
    pub(crate) low: [i32; 3],
    pub(crate) pad_low: u32,
    pub(crate) high: [i32; 3],
    pub(crate) pad_high: u32,
}

/// `Hit` in the shader.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct DeviceHit {
    pub(crate) normal: [f32; 3],
    pub(crate) range_m: f32,
    pub(crate) depth_m: f32,
    pub(crate) incidence_cos: f32,
    pub(crate) weight: f32,
    pub(crate) pad: f32,
}

/// Surface farther from the camera than this, in voxels along an axis, is not rendered.
const FARTHEST: i64 = 1 << 22;

impl Renderer {
    /// Prepares the rendering of a map in its present state.
    ///
    /// # Errors
    /// [`GpuError::Render`] if the configuration is invalid; otherwise errors of the device.
    pub fn new(map: &DeviceMap, config: &RenderConfig) -> Result<Self, GpuError> {
        config.validate()?;
        let gpu = &map.gpu;
        let more = [
            Binding::Uniform(size_of::<Params>() as u64),
            Binding::Read,
            Binding::Storage,
        ];
        let layout = gpu.layout(BINDINGS.into_iter().chain(more));
        let kernel = source(map.paging, &[SURFACE, RENDER]);
        let mut renderer = Self {
            finder: Finder::new(map)?,
            kernel: gpu.kernel(&kernel, "render", &[&map.layout, &layout]),
            layout,
            params: gpu.buffer("a view", size_of::<Params>() as u64, Usage::UNIFORM | Usage::COPY_DST)?,
            config: *config,
            span: None,
            image: None,
        };
        gpu.check()?;
        renderer.refresh(map)?;
        Ok(renderer)
    }

    /// Finds the surface again. Must be called after the map has changed.
    ///
    /// # Errors
    /// Errors of the device.
    pub fn refresh(&mut self, map: &DeviceMap) -> Result<(), GpuError> {
        let min_weight = self.config.min_weight;
        let min_sum = MeshConfig { min_weight }.min_weight_sum().cast_unsigned();
        let blocks = self.finder.find(map, min_sum)?;
        let counts = self.finder.counts(&map.gpu, blocks)?;
        let indices = map.indices(blocks)?;
        let with_surface = indices.iter().zip(counts).filter(|(_, [_, triangles])| *triangles > 0);
        let spans = with_surface.map(|(index, _)| (index.0, index.0));
        self.span = spans.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
        Ok(())
    }

    /// Renders what a camera sees from a pose (`world_from_camera`).
    ///
    /// # Errors
    /// [`GpuError::Render`] if the camera or the pose is invalid, or the camera is outside the grid.
    pub fn view(&mut self, map: &DeviceMap, camera: &Camera, world_from_camera: Pose) -> Result<View, GpuError> {
        camera.check()?;
        let pose = Pose::new(world_from_camera.rotation, world_from_camera.translation).map_err(RenderError::from)?;
        let (width, height) = camera.size();
        let params = self.params(map, camera, pose)?;
        let Some(params) = params else {
            return Ok(View {
                width,
                height,
                hits: vec![None; width * height],
            });
        };
        let gpu = &map.gpu;
        let image = match self.image.take().filter(|image| image.camera == *camera) {
            Some(image) => image,
            None => Image::of(gpu, camera)?,
        };
        gpu.queue.write_buffer(&self.params, 0, bytemuck::bytes_of(&params));
        let more = [&self.params, &image.rays, &image.hits].map(wgpu::Buffer::as_entire_binding);
        let group = gpu.bind(&self.layout, self.finder.resources().chain(more));
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        let mut pass = gpu.pass(&mut encoder, "render");
        pass.set_pipeline(&self.kernel);
        pass.set_bind_group(0, &map.bind_group, &[]);
        pass.set_bind_group(1, &group, &[0, 0]);
        pass.dispatch_workgroups(params.width.div_ceil(8), params.height.div_ceil(8), 1);
        drop(pass);
        gpu.queue.submit([encoder.finish()]);
        let hits = gpu.read_with(&image.hits, 0, image.hits.size(), |bytes| {
            let hits = bytes.par_chunks_exact(size_of::<DeviceHit>());
            hits.map(|bytes| bytemuck::pod_read_unaligned::<DeviceHit>(bytes).seen())
                .collect()
        })?;
        self.image = Some(image);
        Ok(View { width, height, hits })
    }

    /// `None` if there is nothing to see.
    fn params(&self, map: &DeviceMap, camera: &Camera, pose: Pose) -> Result<Option<Params>, GpuError> {
        let Some(anchor) = map.empty.grid().anchor(pose.translation) else {
            return Err(RenderError::Outside(pose.translation.to_array()).into());
        };
        let Some((low, high)) = self.span else { return Ok(None) };
        let (base, fraction) = anchor.split();
        let to_base = |block: IVec3, more: i64| {
            let cells = 8 * block.as_i64vec3() + more - base.as_i64vec3();
            cells.to_array().map(|c| c.clamp(-FARTHEST, FARTHEST) as i32)
        };
        let (low, high) = (to_base(low, 0), to_base(high, 8));
        if low.iter().zip(&high).any(|(low, high)| low >= high) {
            return Ok(None); // too far
        }
        let world = DMat3::from_quat(pose.rotation).as_mat3();
        let (width, height) = camera.size();
        let voxel_size_m = map.config().voxel_size_m;
        let max_range_m = self.config.max_range_m.min(camera.max_range_m());
        Ok(Some(Params {
            base: base.into(),
            width: width as u32,
            // Cells begin at the centres of voxels.
            origin: (fraction - 0.5).as_vec3().into(),
            height: height as u32,
            world_x: world.x_axis.into(),
            max_range_vox: (f64::from(max_range_m) / voxel_size_m) as f32,
            world_y: world.y_axis.into(),
            voxel_size_m: voxel_size_m as f32,
            world_z: world.z_axis.into(),
            low,
            high,
            ..Params::default()
        }))
    }
}

impl DeviceHit {
    fn seen(self) -> Option<Hit> {
        (self.range_m > 0.0).then_some(Hit {
            range_m: self.range_m,
            depth_m: self.depth_m,
            normal: Vec3::from(self.normal),
            incidence_cos: self.incidence_cos,
            weight: self.weight,
        })
    }
}

impl Image {
    fn of(gpu: &Gpu, camera: &Camera) -> Result<Self, GpuError> {
        let (width, height) = camera.size();
        let of_camera = camera.rays();
        let ray = |pixel: usize| {
            let (direction, depth) = of_camera.of(pixel % width, pixel / width);
            direction.as_vec3().extend(depth).to_array()
        };
        let rays: Vec<[f32; 4]> = (0..width * height).into_par_iter().map(ray).collect();
        let image = Self {
            camera: camera.clone(),
            rays: gpu.buffer(
                "the rays of a camera",
                16 * rays.len() as u64,
                Usage::STORAGE | Usage::COPY_DST,
            )?,
            hits: gpu.buffer(
                "an image",
                (size_of::<DeviceHit>() * rays.len()) as u64,
                Usage::STORAGE | Usage::COPY_SRC,
            )?,
        };
        gpu.queue.write_buffer(&image.rays, 0, bytemuck::cast_slice(&rays));
        Ok(image)
    }
}
