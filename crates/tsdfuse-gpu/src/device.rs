//! The device: which adapter, what it can do, and what went wrong on it.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tsdfuse::{fuse::FuseError, map::MapError, mesh::MeshError, render::RenderError};

use crate::timeline::Timeline;

/// Why something could not be done on the device.
#[derive(Debug, thiserror::Error)]
pub enum GpuError {
    /// There is none, or none of the name that was asked for.
    #[error("no GPU can be used: {0}")]
    NoAdapter(String),
    /// The device stopped: it was reset, removed, or a kernel ran too long. What was on it is lost.
    #[error("the GPU stopped working, and what was on it is lost: {0}")]
    Lost(String),
    /// The device has no memory left.
    #[error("the GPU has no memory for {what} ({bytes} bytes)")]
    OutOfMemory {
        /// What it is needed for.
        what: String,
        /// How much was asked for.
        bytes: u64,
    },
    /// More blocks than the device can address.
    #[error("the map needs more than {blocks} blocks, which is all that this GPU can hold")]
    TooManyBlocks {
        /// How many it can hold.
        blocks: u64,
    },
    /// More than one binding of this device can hold.
    #[error("{what} needs {bytes} bytes, but this GPU binds at most {limit} at once")]
    TooLarge {
        /// What.
        what: String,
        /// Its size.
        bytes: u64,
        /// The largest size.
        limit: u64,
    },
    /// The driver or this program is at fault.
    #[error("the GPU reports an error: {0}")]
    Driver(String),
    /// The method does not run on the device.
    #[error("{0}")]
    Unsupported(String),
    /// The scan cannot be fused, there as here.
    #[error(transparent)]
    Fuse(#[from] FuseError),
    /// The map cannot be made.
    #[error(transparent)]
    Map(#[from] MapError),
    /// There is no mesh.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// There is no view.
    #[error(transparent)]
    Render(#[from] RenderError),
}

/// A GPU, opened.
///
/// ```no_run
/// let gpu = tsdfuse_gpu::Gpu::open(None)?;
/// println!("{}", gpu.name());
/// # Ok::<(), tsdfuse_gpu::GpuError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Gpu {
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    info: wgpu::AdapterInfo,
    limits: wgpu::Limits,
    /// What the device said that nobody asked for.
    trouble: Arc<Mutex<Option<Trouble>>>,
    pub(crate) timeline: Timeline,
}

#[derive(Clone, Debug)]
enum Trouble {
    Lost(String),
    Error(String),
}

impl Gpu {
    /// Opens the best adapter: a discrete GPU before an integrated one, software last; or the first whose name contains `name`.
    ///
    /// # Errors
    /// [`GpuError::NoAdapter`] names the adapters that there are.
    pub fn open(name: Option<&str>) -> Result<Self, GpuError> {
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        descriptor.backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
        descriptor.flags = wgpu::InstanceFlags::empty();
        let instance = wgpu::Instance::new(descriptor);
        let adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
        let mut adapters: Vec<_> = adapters.into_iter().map(|a| (a.get_info(), a)).collect();
        adapters.sort_by_key(|(info, _)| rank(info.device_type));
        let names: Vec<String> = adapters.iter().map(|(info, _)| info.name.clone()).collect();
        let is_wanted = |have: &str| name.is_none_or(|want| have.to_lowercase().contains(&want.to_lowercase()));
        let Some((info, adapter)) = adapters.into_iter().find(|(info, _)| is_wanted(&info.name)) else {
            return Err(GpuError::NoAdapter(match name {
                Some(name) if !names.is_empty() => format!("none is called {name}; there are {}", names.join(", ")),
                _ => {
                    "no driver for Vulkan, Metal or DirectX 12 offers one (Mesa's lavapipe makes one of the CPU)".into()
                }
            }));
        };
        let wanted = wgpu::Features::TIMESTAMP_QUERY;
        let request = adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("tsdfuse"),
            required_features: adapter.features() & wanted,
            required_limits: adapter.limits(),
            ..Default::default()
        });
        let (device, queue) =
            pollster::block_on(request).map_err(|e| GpuError::NoAdapter(format!("{}: {e}", info.name)))?;
        let trouble: Arc<Mutex<Option<Trouble>>> = Arc::default();
        let note = {
            let trouble = trouble.clone();
            move |what: Trouble| {
                trouble
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .get_or_insert(what);
            }
        };
        let note_error = note.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            note_error(Trouble::Error(one_line(&error.to_string())));
        }));
        device.set_device_lost_callback(move |_, message| note(Trouble::Lost(one_line(&message))));
        let limits = device.limits();
        Ok(Self {
            device,
            queue,
            info,
            limits,
            trouble,
            timeline: Timeline::default(),
        })
    }

    /// The adapter's name and the driver's.
    pub fn name(&self) -> String {
        let driver = [self.info.driver.as_str(), self.info.driver_info.as_str()].join(" ");
        format!("{} ({:?}, {})", self.info.name, self.info.backend, driver.trim())
    }

    /// Whether the adapter is a CPU that does as a GPU would.
    pub fn is_software(&self) -> bool {
        self.info.device_type == wgpu::DeviceType::Cpu
    }

    /// The most bytes that one binding holds.
    pub(crate) fn binding_limit(&self) -> u64 {
        self.limits
            .max_storage_buffer_binding_size
            .min(self.limits.max_buffer_size)
    }

    /// The most storage buffers that one kernel uses.
    pub(crate) fn storage_buffers(&self) -> u32 {
        self.limits.max_storage_buffers_per_shader_stage
    }

    /// Makes a buffer, all zero.
    pub(crate) fn buffer(&self, what: &str, bytes: u64, usage: wgpu::BufferUsages) -> Result<wgpu::Buffer, GpuError> {
        let limit = if usage.contains(wgpu::BufferUsages::STORAGE) {
            self.binding_limit()
        } else {
            self.limits.max_buffer_size
        };
        if bytes > limit {
            let what = what.to_owned();
            return Err(GpuError::TooLarge { what, bytes, limit });
        }
        let scope = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(what),
            size: bytes,
            usage,
            mapped_at_creation: false,
        });
        match pollster::block_on(scope.pop()) {
            None => Ok(buffer),
            Some(_) => Err(GpuError::OutOfMemory {
                what: what.to_owned(),
                bytes,
            }),
        }
    }

    /// What went wrong since the last time, if anything did.
    pub(crate) fn check(&self) -> Result<(), GpuError> {
        let trouble = self.trouble.lock().unwrap_or_else(PoisonError::into_inner).take();
        match trouble {
            None => Ok(()),
            Some(Trouble::Lost(why)) => Err(GpuError::Lost(why)),
            Some(Trouble::Error(why)) => Err(GpuError::Driver(why)),
        }
    }

    /// Waits until a submission is done, or all are, and callbacks have been called.
    pub(crate) fn wait(&self, submission: Option<wgpu::SubmissionIndex>) -> Result<(), GpuError> {
        let done = self.device.poll(wgpu::PollType::Wait {
            submission_index: submission,
            timeout: Some(LONGEST_WAIT),
        });
        self.check()?;
        done.map(|_| ()).map_err(|e| GpuError::Lost(e.to_string()))
    }

    /// Copies part of a buffer back.
    pub(crate) fn read(&self, buffer: &wgpu::Buffer, offset: u64, bytes: u64) -> Result<Vec<u8>, GpuError> {
        if bytes == 0 {
            return Ok(Vec::new());
        }
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        let copy = self.buffer("reading back", bytes, usage)?;
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(buffer, offset, &copy, 0, bytes);
        let submission = self.queue.submit([encoder.finish()]);
        copy.map_async(wgpu::MapMode::Read, .., |_| {});
        self.wait(Some(submission))?;
        mapped(&copy)
    }
}

/// No kernel takes as long, not even in software on a busy machine.
const LONGEST_WAIT: Duration = Duration::from_secs(600);

/// What a buffer holds that was mapped for reading.
pub(crate) fn mapped(buffer: &wgpu::Buffer) -> Result<Vec<u8>, GpuError> {
    let view = buffer.get_mapped_range(..).map_err(|e| GpuError::Lost(e.to_string()))?;
    Ok(view.to_vec())
}

fn rank(kind: wgpu::DeviceType) -> u8 {
    match kind {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    }
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
