//! A scan on its way through the device: its returns, what kernels are told of it, and what they count.

use std::sync::{
    Arc,
    atomic::{AtomicUsize, Ordering},
};

use wgpu::BufferUsages as Usage;

use crate::device::{Gpu, GpuError};
use crate::frame::Frame;
use crate::map::Header;
use crate::scratch::Scratch;

/// The buffers of one scan, kept from scan to scan.
#[derive(Debug)]
pub(crate) struct Flight {
    /// What to call the scan in messages.
    pub(crate) name: String,
    /// Where frames and returns are written by the host, and the same on the device.
    staging: wgpu::Buffer,
    pub(crate) data: wgpu::Buffer,
    /// What was counted, on the device's side of the bus and on ours.
    counts: wgpu::Buffer,
    pub(crate) bind_group: wgpu::BindGroup,
    pub(crate) scratch: Scratch,
    /// Where the returns begin in `data`, and where they end.
    bytes: u64,
    /// Where each dispatch finds its frame.
    pub(crate) frames: Vec<Frame>,
    /// Callbacks that are outstanding.
    pending: Arc<AtomicUsize>,
    submission: Option<wgpu::SubmissionIndex>,
}

/// What a scan brings along.
#[derive(Clone, Copy)]
pub(crate) struct Parcel<'a> {
    pub(crate) name: &'a str,
    /// The columns of its returns.
    pub(crate) columns: &'a [&'a [u8]],
    /// What its kernels leave to each other.
    pub(crate) scratch: &'a Scratch,
}

/// Frames are this far apart: what all devices can bind.
pub(crate) const FRAME_STRIDE: u64 = 256;
const _: () = assert!(size_of::<Frame>() as u64 <= FRAME_STRIDE);

impl Flight {
    /// Takes a scan and its frames, one for each dispatch. The old one's buffers are used if they are large enough.
    pub(crate) fn load(
        old: Option<Self>,
        gpu: &Gpu,
        layout: &wgpu::BindGroupLayout,
        frames: Vec<Frame>,
        parcel: &Parcel<'_>,
    ) -> Result<Self, GpuError> {
        let Parcel { name, columns, scratch } = *parcel;
        let returns_at = FRAME_STRIDE * frames.len().max(1) as u64;
        // Whole words.
        let returns = columns.iter().map(|c| c.len() as u64).sum::<u64>().next_multiple_of(4);
        let bytes = returns_at + returns.max(4);
        if bytes > gpu.binding_limit() {
            return Err(GpuError::TooLarge {
                what: format!("{name}: the scan"),
                bytes,
                limit: gpu.binding_limit(),
            });
        }
        let (staging, data, counts) = match old {
            Some(old) if old.data.size() >= bytes => (old.staging, old.data, old.counts),
            old => {
                let room = bytes.next_power_of_two().min(gpu.binding_limit());
                let staging = gpu.buffer("uploading", room, Usage::MAP_WRITE | Usage::COPY_SRC)?;
                let data = gpu.buffer("a scan", room, Usage::STORAGE | Usage::UNIFORM | Usage::COPY_DST)?;
                let counts = old.map(|old| old.counts);
                let new = || gpu.buffer("counts", Header::BYTES, Usage::MAP_READ | Usage::COPY_DST);
                staging.map_async(wgpu::MapMode::Write, .., |_| {});
                gpu.wait(None)?;
                (staging, data, counts.map_or_else(new, Ok)?)
            }
        };
        {
            let lost = |e: wgpu::MapRangeError| GpuError::Lost(e.to_string());
            let mut view = staging.get_mapped_range_mut(..).map_err(lost)?;
            for (at, frame) in (0..).step_by(FRAME_STRIDE as usize).zip(&frames) {
                view.slice(at..at + size_of::<Frame>())
                    .copy_from_slice(bytemuck::bytes_of(frame));
            }
            let mut at = returns_at as usize;
            for column in columns {
                view.slice(at..at + column.len()).copy_from_slice(column);
                at += column.len();
            }
        }
        staging.unmap();
        let part = |offset, size| {
            wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                buffer: &data,
                offset,
                size: std::num::NonZeroU64::new(size),
            })
        };
        let frame = part(0, size_of::<Frame>() as u64);
        let scan = [frame, part(returns_at, bytes - returns_at)];
        let left = scratch.buffers().iter().map(wgpu::Buffer::as_entire_binding);
        let bind_group = gpu.bind(layout, scan.into_iter().chain(left));
        Ok(Self {
            name: name.to_owned(),
            staging,
            data,
            counts,
            bind_group,
            scratch: scratch.clone(),
            bytes,
            frames,
            pending: Arc::default(),
            submission: None,
        })
    }

    /// Copies the scan to the device.
    pub(crate) fn upload(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.copy_buffer_to_buffer(&self.staging, 0, &self.data, 0, self.bytes);
    }

    /// Sends what was recorded, and then the map's counters back.
    pub(crate) fn submit(
        &mut self,
        gpu: &Gpu,
        mut encoder: wgpu::CommandEncoder,
        state: &wgpu::Buffer,
        is_first: bool,
    ) {
        encoder.copy_buffer_to_buffer(state, 0, &self.counts, 0, Header::BYTES);
        self.submission = Some(gpu.queue.submit([encoder.finish()]));
        let called = |pending: &Arc<AtomicUsize>| {
            pending.fetch_add(1, Ordering::AcqRel);
            let pending = pending.clone();
            move |_: Result<(), wgpu::BufferAsyncError>| {
                pending.fetch_sub(1, Ordering::AcqRel);
            }
        };
        self.counts.map_async(wgpu::MapMode::Read, .., called(&self.pending));
        if is_first {
            // For the next scan.
            self.staging.map_async(wgpu::MapMode::Write, .., called(&self.pending));
        }
    }

    /// Waits for what was sent, and tells the counters after it.
    pub(crate) fn wait(&self, gpu: &Gpu) -> Result<Header, GpuError> {
        while self.pending.load(Ordering::Acquire) > 0 {
            gpu.wait(self.submission.clone())?;
        }
        let lost = |e: wgpu::MapRangeError| GpuError::Lost(e.to_string());
        let header = Header::parse(&self.counts.get_mapped_range(..).map_err(lost)?);
        self.counts.unmap();
        Ok(header)
    }
}
