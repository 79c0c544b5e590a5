//! The device: opening it, its buffers, and the errors that it reports.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::error::GpuError;
use crate::timeline::{Recorder, Stage, Timeline};

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
    /// Errors that the device reported by itself.
    trouble: Arc<Mutex<Trouble>>,
    timeline: Timeline,
    /// The buffer that data is read back through, kept for the next time.
    landing: Arc<Mutex<Option<wgpu::Buffer>>>,
}

#[derive(Clone, Debug, Default)]
struct Trouble {
    /// Why the device is lost. It stays lost.
    lost: Option<String>,
    error: Option<String>,
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
        let trouble: Arc<Mutex<Trouble>> = Arc::default();
        let [on_error, on_loss] = [trouble.clone(), trouble.clone()];
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            lock(&on_error).error.get_or_insert(one_line(&error.to_string()));
        }));
        device.set_device_lost_callback(move |_, why| {
            lock(&on_loss).lost.get_or_insert(one_line(&why));
        });
        let limits = device.limits();
        Ok(Self {
            device,
            queue,
            info,
            limits,
            trouble,
            timeline: Timeline::default(),
            landing: Arc::default(),
        })
    }

    /// The adapter's name and the driver's.
    pub fn name(&self) -> String {
        let driver = [self.info.driver.as_str(), self.info.driver_info.as_str()].join(" ");
        format!("{} ({:?}, {})", self.info.name, self.info.backend, driver.trim())
    }

    /// Whether the adapter is software that runs on the CPU.
    pub fn is_software(&self) -> bool {
        self.info.device_type == wgpu::DeviceType::Cpu
    }

    /// The largest size of a binding, in bytes.
    pub(crate) fn binding_limit(&self) -> u64 {
        self.limits
            .max_storage_buffer_binding_size
            .min(self.limits.max_buffer_size)
    }

    /// The most storage buffers that one kernel can use.
    pub(crate) fn storage_buffers(&self) -> u32 {
        self.limits.max_storage_buffers_per_shader_stage
    }

    /// Creates a buffer filled with zeros.
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

    /// Returns the error that the device reported since the last call, if any.
    pub(crate) fn check(&self) -> Result<(), GpuError> {
        let Some(error) = lock(&self.trouble).error.take() else {
            return self.check_lost();
        };
        // A device that is being lost may report errors before it reports the loss.
        let _ = self.device.poll(wgpu::PollType::Poll);
        self.check_lost()?;
        Err(GpuError::Driver(error))
    }

    fn check_lost(&self) -> Result<(), GpuError> {
        lock(&self.trouble)
            .lost
            .clone()
            .map_or(Ok(()), |why| Err(GpuError::Lost(why)))
    }

    /// Waits until a submission, or all of them, are done and their callbacks have been called.
    pub(crate) fn wait(&self, submission: Option<wgpu::SubmissionIndex>) -> Result<(), GpuError> {
        let done = self.device.poll(wgpu::PollType::Wait {
            submission_index: submission,
            timeout: Some(LONGEST_WAIT),
        });
        self.check()?;
        done.map(|_| ()).map_err(|e| GpuError::Lost(e.to_string()))
    }

    /// Copies part of a buffer back and passes it to a closure.
    pub(crate) fn read_with<T>(
        &self,
        buffer: &wgpu::Buffer,
        offset: u64,
        bytes: u64,
        take: impl FnOnce(&[u8]) -> T,
    ) -> Result<T, GpuError> {
        if bytes == 0 {
            return Ok(take(&[]));
        }
        let kept = lock(&self.landing).take().filter(|kept| kept.size() >= bytes);
        let landing = match kept {
            Some(kept) => kept,
            None => {
                let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
                self.buffer("reading back", bytes, usage)?
            }
        };
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(buffer, offset, &landing, 0, bytes);
        let submission = self.queue.submit([encoder.finish()]);
        landing.map_async(wgpu::MapMode::Read, ..bytes, |_| {});
        self.wait(Some(submission))?;
        let lost = |e: wgpu::MapRangeError| GpuError::Lost(e.to_string());
        let taken = take(&landing.get_mapped_range(..bytes).map_err(lost)?);
        landing.unmap();
        *lock(&self.landing) = Some(landing);
        Ok(taken)
    }

    /// Copies part of a buffer back.
    pub(crate) fn read(&self, buffer: &wgpu::Buffer, offset: u64, bytes: u64) -> Result<Vec<u8>, GpuError> {
        self.read_with(buffer, offset, bytes, <[u8]>::to_vec)
    }

    /// Starts to record how long each kernel takes; returns false if the device has no clock for that.
    pub fn record_timeline(&self) -> bool {
        let has_clock = self.device.features().contains(wgpu::Features::TIMESTAMP_QUERY);
        if has_clock {
            self.timeline.start(&self.device);
        }
        has_clock
    }

    /// Stops recording, and returns how long each kernel took, in the order in which they were submitted (at most 2048).
    ///
    /// # Errors
    /// [`GpuError::Lost`] if the device is gone.
    pub fn timeline(&self) -> Result<Vec<Stage>, GpuError> {
        let recorder = self.timeline.stop();
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

    /// Whether each kernel should have a pass of its own, so that it can be timed.
    pub(crate) fn is_timed(&self) -> bool {
        self.timeline.is_running()
    }

    /// Begins a pass of kernels.
    pub(crate) fn pass<'a>(&self, encoder: &'a mut wgpu::CommandEncoder, name: &'static str) -> wgpu::ComputePass<'a> {
        self.timeline.pass(encoder, name)
    }
}

/// An environment variable, and the value that keeps Mesa from printing "error: XDG_RUNTIME_DIR is invalid or not set" to
/// stderr, twice for each device that is opened. `None` where it is not needed.
///
/// On Linux, a Vulkan layer of Mesa connects to Wayland to find the display's GPU. This crate has no use for that, but a
/// library cannot switch the layer off, since changing the environment of a running program is unsafe. A program can restart
/// itself with the variable before it opens a device, as below, or set it for a child process.
///
/// ```no_run
/// # #[cfg(unix)] {
/// use std::os::unix::process::CommandExt;
///
/// if let Some((name, value)) = tsdfuse_gpu::quiet_variable() {
///     let mut again = std::process::Command::new(std::env::current_exe()?);
///     let error = again.args(std::env::args_os().skip(1)).env(name, value).exec();
///     eprintln!("{error}"); // exec returns only if it fails; the program can go on
/// }
/// # }
/// # Ok::<(), std::io::Error>(())
/// ```
pub fn quiet_variable() -> Option<(&'static str, &'static str)> {
    let is_set = |name| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    // Who sets the third one wants that layer.
    let is_fine = ["XDG_RUNTIME_DIR", LAYER_OFF.0, "MESA_VK_DEVICE_SELECT"]
        .into_iter()
        .any(is_set);
    (cfg!(target_os = "linux") && !is_fine).then_some(LAYER_OFF)
}

/// Switches off Mesa's `VK_LAYER_MESA_device_select`.
const LAYER_OFF: (&str, &str) = ("NODEVICE_SELECT", "1");

/// Locks a mutex. A thread that panicked while holding it cannot have left the value half-changed.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// No kernel takes this long, not even in software on a busy machine.
const LONGEST_WAIT: Duration = Duration::from_secs(600);

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

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::{DeviceMap, Fuser, PoolConfig};
    use tsdfuse::{MapConfig, Pose, Scan, fuse::Method, glam::Vec3};

    /// A device of its own for each test; `None` where there is none and none is required.
    pub(crate) fn gpu() -> Option<Gpu> {
        let gpu = Gpu::open(None);
        assert!(
            gpu.is_ok() || std::env::var_os("TSDFUSE_REQUIRE_GPU").is_none(),
            "{gpu:?}"
        );
        gpu.ok()
    }

    #[test]
    fn a_lost_device_is_told_in_one_sentence_and_stays_lost() {
        let Some(gpu) = gpu() else { return };
        let map = DeviceMap::new(&gpu, MapConfig::default(), PoolConfig::default()).unwrap();
        let mut fuser = Fuser::new(map, Method::Raycast, &Default::default(), None).unwrap();
        let scan = Scan {
            points: vec![Vec3::X; 9],
            pose: Some(Pose::IDENTITY),
            ..Default::default()
        };
        fuser.integrate(&scan).unwrap();
        gpu.device.destroy();
        let told = fuser.integrate(&scan).and_then(|_| fuser.finish()).unwrap_err();
        assert!(matches!(told, GpuError::Lost(_)), "{told}");
        assert!(!told.to_string().contains('\n'));
        assert!(matches!(fuser.map().download(), Err(GpuError::Lost(_))));
    }

    #[test]
    fn what_is_too_large_is_refused_by_name() {
        let Some(gpu) = gpu() else { return };
        let told = gpu.buffer("a scan", 1 << 60, wgpu::BufferUsages::STORAGE).unwrap_err();
        assert!(
            told.to_string()
                .starts_with("a scan needs 1152921504606846976 bytes, but "),
            "{told}"
        );
        gpu.check().unwrap();
    }
}
