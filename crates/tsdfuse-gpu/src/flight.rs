//! A scan in flight: its returns, the parameters of its dispatches, and what its kernels count.

use std::sync::{
    Arc,
    atomic::{AtomicUsize, Ordering},
};

use rayon::slice::ParallelSliceMut;
use tsdfuse::index::BlockIndex;
use wgpu::BufferUsages as Usage;

use crate::device::Gpu;
use crate::error::GpuError;
use crate::frame::Frame;
use crate::map::{Header, index_of};
use crate::scratch::Scratch;

/// The buffers of one scan, reused for later scans.
#[derive(Debug)]
pub(crate) struct Flight {
    /// The scan's name in messages.
    pub(crate) name: String,
    /// Frames and returns: the buffer that the host writes, and its copy on the device.
    staging: wgpu::Buffer,
    pub(crate) data: wgpu::Buffer,
    /// The map's counters after the scan and the first part of the list of updated blocks, for the host to read.
    counts: wgpu::Buffer,
    /// The rest of that list, on the device.
    rest: Option<wgpu::Buffer>,
    pub(crate) bind_group: wgpu::BindGroup,
    pub(crate) scratch: Scratch,
    /// The used bytes of `data`.
    bytes: u64,
    /// One frame for each dispatch.
    pub(crate) frames: Vec<Frame>,
    /// How many callbacks are outstanding.
    pending: Arc<AtomicUsize>,
    submission: Option<wgpu::SubmissionIndex>,
}

/// The contents of a new flight.
#[derive(Clone, Copy)]
pub(crate) struct Parcel<'a> {
    pub(crate) name: &'a str,
    /// The columns of its returns.
    pub(crate) columns: &'a [&'a [u8]],
    /// The buffers through which its kernels pass data to later ones.
    pub(crate) scratch: &'a Scratch,
    /// How many updated blocks the host expects at most. If there are more, they are read back later, which takes longer.
    pub(crate) most_updated: u32,
}

/// Bytes from one frame to the next: an alignment that every device supports.
pub(crate) const FRAME_STRIDE: u64 = 256;
const _: () = assert!(size_of::<Frame>() as u64 <= FRAME_STRIDE);

impl Flight {
    /// Loads a scan and its frames, one for each dispatch. Reuses the buffers of an old flight if they are large enough.
    pub(crate) fn load(
        old: Option<Self>,
        gpu: &Gpu,
        layout: &wgpu::BindGroupLayout,
        frames: Vec<Frame>,
        parcel: &Parcel<'_>,
    ) -> Result<Self, GpuError> {
        let Parcel {
            name,
            columns,
            scratch,
            most_updated,
        } = *parcel;
        let returns_at = FRAME_STRIDE * frames.len().max(1) as u64;
        // Rounded up to whole words.
        let returns = columns.iter().map(|c| c.len() as u64).sum::<u64>().next_multiple_of(4);
        let bytes = returns_at + returns.max(4);
        if bytes > gpu.binding_limit() {
            return Err(GpuError::TooLarge {
                what: format!("{name}: the scan"),
                bytes,
                limit: gpu.binding_limit(),
            });
        }
        let (sent, counted) = old.map(|old| ((old.staging, old.data), (old.counts, old.rest))).unzip();
        let (staging, data) = match sent.filter(|(_, data)| data.size() >= bytes) {
            Some(large_enough) => large_enough,
            None => {
                let room = bytes.next_power_of_two().min(gpu.binding_limit());
                let staging = gpu.buffer("uploading", room, Usage::MAP_WRITE | Usage::COPY_SRC)?;
                let data = gpu.buffer("a scan", room, Usage::STORAGE | Usage::UNIFORM | Usage::COPY_DST)?;
                staging.map_async(wgpu::MapMode::Write, .., |_| {});
                gpu.wait(None)?;
                (staging, data)
            }
        };
        let room = Header::LIST + Header::ENTRY * u64::from(most_updated);
        let (counts, rest) = match counted.filter(|(counts, _)| counts.size() >= room) {
            Some(large_enough) => large_enough,
            None => (gpu.buffer("counts", room, Usage::MAP_READ | Usage::COPY_DST)?, None),
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
            rest,
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

    /// Makes room for the list of updated blocks of a map whose state is this buffer. Must precede [`Self::submit`].
    pub(crate) fn fit_list(&mut self, gpu: &Gpu, state: &wgpu::Buffer) -> Result<(), GpuError> {
        let bytes = state.size().saturating_sub(self.counts.size());
        if self.rest.as_ref().map_or(0, wgpu::Buffer::size) < bytes {
            let usage = Usage::COPY_SRC | Usage::COPY_DST;
            self.rest = Some(gpu.buffer("updated blocks", bytes, usage)?);
        }
        Ok(())
    }

    /// Submits the recorded commands, and after them copies of the map's counters and of the list of updated blocks.
    pub(crate) fn submit(
        &mut self,
        gpu: &Gpu,
        mut encoder: wgpu::CommandEncoder,
        state: &wgpu::Buffer,
        is_first: bool,
    ) {
        let first = state.size().min(self.counts.size());
        encoder.copy_buffer_to_buffer(state, 0, &self.counts, 0, first);
        if let Some(rest) = self.rest.as_ref().filter(|_| state.size() > first) {
            encoder.copy_buffer_to_buffer(state, first, rest, 0, state.size() - first);
        }
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
            // So that the next scan can be written.
            self.staging.map_async(wgpu::MapMode::Write, .., called(&self.pending));
        }
    }

    /// Waits until the scan is done; returns the counters after it, and the blocks that it updated, sorted, if no flag is
    /// set.
    pub(crate) fn wait(&self, gpu: &Gpu) -> Result<(Header, Vec<BlockIndex>), GpuError> {
        while self.pending.load(Ordering::Acquire) > 0 {
            gpu.wait(self.submission.clone())?;
        }
        let lost = |e: wgpu::MapRangeError| GpuError::Lost(e.to_string());
        let counted = self.counts.get_mapped_range(..).map_err(lost)?;
        let header = Header::parse(&counted);
        let bytes = Header::ENTRY * u64::from(if header.flags == 0 { header.updated } else { 0 });
        let (_, list) = counted.split_at(Header::LIST as usize);
        let first = list.len().min(bytes as usize);
        let blocks = |list: &[u8]| list.chunks_exact(Header::ENTRY as usize).map(index_of).collect();
        let mut updated: Vec<BlockIndex> = blocks(&list[..first]);
        drop(counted);
        self.counts.unmap();
        if let Some(rest) = &self.rest {
            updated.append(&mut gpu.read_with(rest, 0, bytes - first as u64, blocks)?);
        }
        updated.par_sort_unstable();
        Ok((header, updated))
    }
}
