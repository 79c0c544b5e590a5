//! Fusing scans on the device, several in flight.

use std::collections::VecDeque;
use std::ops::Range;

use tsdfuse::{
    Scan, SensorModel, VoxelMap,
    fuse::{FuseConfig, FuseError, Method, Skipped},
    index::BlockIndex,
    map::WEIGHT_SCALE,
};

use crate::error::GpuError;
use crate::flight::{FRAME_STRIDE, Flight, Parcel};
use crate::frame::{ALLOCATE, FUSE, Frame};
use crate::kernels::{LIMIT_WEIGHTS, Step, WORKGROUP, Work};
use crate::map::{DeviceMap, Header};
use crate::method::Prepare;
use crate::prepared::{Prepared, pieces};
use crate::scratch::Scratch;
use crate::shader::{Binding, FRAME, KEEP, source};

/// The result of fusing one scan.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Fused {
    /// The scan's name.
    pub name: String,
    /// The blocks that were created or updated, sorted.
    pub updated_blocks: Vec<BlockIndex>,
    /// Returns that reached the map.
    pub fused_returns: u64,
    /// Returns that could not be used, by reason.
    pub skipped: Skipped,
}

/// Fuses scans into a [`DeviceMap`].
///
/// Uploads, kernels and the CPU's share of the work overlap, so a scan is reported a few calls after it was submitted.
#[derive(Debug)]
pub struct Fuser {
    map: DeviceMap,
    prepare: Prepare,
    /// Run once a scan, first; then come the kernels that run for each piece of it.
    before: Vec<Kernel>,
    allocate: Kernel,
    fuse: Kernel,
    limit_weights: Kernel,
    /// Run once a scan, last.
    after: Vec<Kernel>,
    layout: wgpu::BindGroupLayout,
    scratch: Scratch,
    /// Scans in flight, the oldest first.
    flights: VecDeque<Sent>,
    idle: Vec<Flight>,
    /// The most updated blocks that the next scan is expected to have.
    most_updated: u32,
    /// Results that the caller has not received yet.
    done: Vec<Fused>,
}

/// A compiled kernel.
#[derive(Debug)]
struct Kernel {
    step: Step,
    pipeline: wgpu::ComputePipeline,
}

/// A scan in flight.
#[derive(Debug)]
struct Sent {
    flight: Flight,
    /// The number of scans in the map, including this one.
    integrations: u32,
}

/// The most updated blocks that the first scan is expected to have.
const FIRST_MOST_UPDATED: u32 = 512;

/// No scan is expected to update more blocks than this: 16 MiB of list.
const LARGEST_MOST_UPDATED: u32 = 1 << 20;

/// The most scans in flight.
const IN_FLIGHT: usize = 4;

/// The most returns of one dispatch: 65 535 workgroups, which every device supports, with three threads per return.
const MOST_RETURNS: usize = 21_845 * WORKGROUP as usize;

/// A voxel's sums fit into 32 bits as long as its weight stays below this.
const MOST_WEIGHT: f32 = 65_535.0;

impl Fuser {
    /// Prepares a method to fuse into `map`; `sensor` is the sensor's model, if known.
    ///
    /// # Errors
    /// [`GpuError::Unsupported`] if the method does not run on the device.
    pub fn new(
        map: DeviceMap,
        method: Method,
        config: &FuseConfig,
        sensor: Option<&SensorModel>,
    ) -> Result<Self, GpuError> {
        config.validate()?;
        let (prepare, kernels) = Prepare::new(method, config, sensor)?;
        let gpu = &map.gpu;
        let scan = [Binding::Uniform(size_of::<Frame>() as u64), Binding::Read];
        let scratch = Scratch::default();
        let layout = gpu.layout(scan.into_iter().chain([Binding::Storage; Scratch::BUFFERS]));
        let groups = [&map.layout, &layout];
        let text = source(map.paging, &kernels.parts);
        let kernel = |&step: &Step| Kernel {
            step,
            pipeline: gpu.kernel(&text, step.entry, &groups),
        };
        let allocate = kernel(&kernels.allocate);
        let fuse = if kernels.fuse.entry == kernels.allocate.entry {
            Kernel {
                step: kernels.fuse,
                pipeline: allocate.pipeline.clone(),
            }
        } else {
            kernel(&kernels.fuse)
        };
        let limit_weights = Kernel {
            step: LIMIT_WEIGHTS,
            pipeline: gpu.kernel(&source(map.paging, &[FRAME, KEEP]), LIMIT_WEIGHTS.entry, &groups),
        };
        let [before, after] = [&kernels.before, &kernels.after].map(|steps| steps.iter().map(kernel).collect());
        gpu.check()?;
        Ok(Self {
            prepare,
            before,
            allocate,
            fuse,
            limit_weights,
            after,
            layout,
            scratch,
            flights: VecDeque::new(),
            idle: Vec::new(),
            most_updated: FIRST_MOST_UPDATED,
            done: Vec::new(),
            map,
        })
    }

    /// Submits a scan, and returns the results of earlier scans that have finished since the last call.
    ///
    /// # Errors
    /// If [`GpuError::is_bad_scan`], this scan cannot be fused: the map is unchanged, and further scans can follow. Any other
    /// error concerns the device, and the scans that were in flight are not fused; a later call still returns results that
    /// were ready before. Unless the error is [`GpuError::Lost`], [`Self::map`] holds all scans that were reported.
    pub fn integrate(&mut self, scan: &Scan) -> Result<Vec<Fused>, GpuError> {
        scan.check().map_err(FuseError::from)?;
        while self.flights.len() >= IN_FLIGHT {
            self.finish_one()?;
        }
        let before = self
            .flights
            .back()
            .map_or(self.map.integrations, |sent| sent.integrations);
        let prepared = self.prepare.prepare(scan)?;
        let next = before.wrapping_add(1).max(1);
        let by_block = self.fuse.step.work == Work::Blocks;
        let frames = frames(&prepared, &self.map.empty, next, by_block)?;
        let gpu = &self.map.gpu;
        self.scratch.fit(gpu, &prepared.scratch())?;
        let parcel = Parcel {
            name: &scan.name,
            columns: &prepared.columns(),
            scratch: &self.scratch,
            most_updated: self.most_updated,
        };
        let integrations = if frames.is_empty() { before } else { next };
        let mut flight = Flight::load(self.idle.pop(), gpu, &self.layout, frames, &parcel)?;
        flight.fit_list(gpu, self.map.state())?;
        self.send(&mut flight, true);
        self.flights.push_back(Sent { flight, integrations });
        Ok(std::mem::take(&mut self.done))
    }

    /// Waits for all scans in flight, and returns the results that were not returned yet.
    ///
    /// # Errors
    /// As [`Self::integrate`].
    pub fn finish(&mut self) -> Result<Vec<Fused>, GpuError> {
        while !self.flights.is_empty() {
            self.finish_one()?;
        }
        Ok(std::mem::take(&mut self.done))
    }

    /// The map; it may or may not contain the scans in flight.
    pub fn map(&self) -> &DeviceMap {
        &self.map
    }

    /// Waits for all scans in flight, and returns the map.
    ///
    /// # Errors
    /// As [`Self::integrate`].
    pub fn into_map(mut self) -> Result<DeviceMap, GpuError> {
        self.finish()?;
        Ok(self.map)
    }

    /// The buffers through which kernels pass data to later ones.
    #[cfg(test)]
    pub(crate) fn scratch(&self) -> &[wgpu::Buffer] {
        self.scratch.buffers()
    }

    /// Submits a scan's kernels, and its returns if it is submitted for the first time.
    fn send(&self, flight: &mut Flight, is_first: bool) {
        let gpu = &self.map.gpu;
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        if is_first {
            flight.upload(&mut encoder);
        }
        if !self.before.is_empty() {
            flight.scratch.clear(&mut encoder);
        }
        encoder.clear_buffer(self.map.state(), Header::SCAN, Some(Header::BYTES - Header::SCAN));
        let record = |pass: &mut wgpu::ComputePass<'_>, kernel: &Kernel, (offset, frame): (u32, &Frame)| {
            pass.set_bind_group(0, &self.map.bind_group, &[]);
            pass.set_bind_group(1, &flight.bind_group, &[offset]);
            pass.set_pipeline(&kernel.pipeline);
            pass.dispatch_workgroups(kernel.step.work.workgroups(frame, self.map.capacity()), 1, 1);
        };
        if gpu.is_timed() {
            for (kernel, piece) in self.in_order(&flight.frames) {
                record(&mut gpu.pass(&mut encoder, kernel.step.name), kernel, piece);
            }
        } else {
            // One pass is recorded faster than one per kernel; each kernel still waits for the one before it.
            let mut pass = gpu.pass(&mut encoder, "a scan");
            self.in_order(&flight.frames)
                .for_each(|(kernel, piece)| record(&mut pass, kernel, piece));
        }
        flight.submit(gpu, encoder, self.map.state(), is_first);
    }

    /// The kernels of a scan in order, each with its frame and the frame's offset.
    fn in_order<'a>(&'a self, frames: &'a [Frame]) -> impl Iterator<Item = (&'a Kernel, (u32, &'a Frame))> {
        let pieces = (0..).step_by(FRAME_STRIDE as usize).zip(frames);
        let once = |kernels: &'a [Kernel]| {
            kernels
                .iter()
                .zip(frames.first().map(|frame| (0, frame)).into_iter().cycle())
        };
        let each = pieces.flat_map(|piece| {
            let (first, second) = match piece.1.mode {
                FUSE => (&self.fuse, Some(&self.limit_weights)),
                _ => (&self.allocate, None),
            };
            std::iter::once(first).chain(second).map(move |kernel| (kernel, piece))
        });
        once(&self.before).chain(each).chain(once(&self.after))
    }

    /// Waits for the oldest scan in flight. If it did not fit, grows the map and repeats all scans in flight.
    fn finish_one(&mut self) -> Result<(), GpuError> {
        while let Some(first) = self.flights.front() {
            let (header, updated_blocks) = first.flight.wait(&self.map.gpu)?;
            if header.flags == 0 {
                return self.report(header, updated_blocks);
            }
            for later in self.flights.iter().skip(1) {
                later.flight.wait(&self.map.gpu)?;
            }
            // On failure none of them is repeated, and all are forgotten.
            let mut flights = std::mem::take(&mut self.flights);
            self.map.make_room(header)?;
            let (gpu, state) = (&self.map.gpu, self.map.state());
            flights
                .iter_mut()
                .try_for_each(|sent| sent.flight.fit_list(gpu, state))?;
            flights.iter_mut().for_each(|sent| self.send(&mut sent.flight, false));
            self.flights = flights;
        }
        Ok(())
    }

    fn report(&mut self, header: Header, updated_blocks: Vec<BlockIndex>) -> Result<(), GpuError> {
        let Some(sent) = self.flights.pop_front() else {
            return Ok(());
        };
        self.map.integrations = sent.integrations;
        let name = sent.flight.name.clone();
        self.idle.push(sent.flight);
        if header.lost > 0 {
            let lost = header.lost;
            let why = format!("{name}: {lost} updates found no block, since two runs of one kernel differ");
            return Err(GpuError::Driver(why));
        }
        let expected = header.updated.saturating_mul(2).min(LARGEST_MOST_UPDATED);
        self.most_updated = self.most_updated.max(expected);
        self.done.push(Fused {
            name,
            updated_blocks,
            fused_returns: header.fused.into(),
            skipped: Skipped {
                outside_grid: header.outside_grid.into(),
                without_normal: header.without_normal.into(),
                without_weight: header.without_weight.into(),
                outside_image: header.outside_image.into(),
                hidden: header.hidden.into(),
            },
        });
        Ok(())
    }
}

/// The frames of a scan's dispatches: first those that create blocks, then those that update voxels.
fn frames(prepared: &Prepared<'_>, map: &VoxelMap, stamp: u32, by_block: bool) -> Result<Vec<Frame>, GpuError> {
    let (all, weights) = (prepared.items, &prepared.weights);
    let mut frame = Frame::of(prepared.scan, map)?;
    frame.stamp = stamp;
    prepared.place_columns(&mut frame);
    // The sums of a voxel must not overflow before its weight is limited again.
    let room = MOST_WEIGHT - map.config().max_weight;
    let most: f32 = weights.iter().sum::<f32>().min(room);
    // Each return makes up to nine updates, each rounded by at most half a unit.
    let most_sum = ((most * WEIGHT_SCALE as f32).ceil() as u32).saturating_add(5 * all as u32);
    frame.heavy_sum = frame.max_weight_sum.saturating_sub(most_sum);
    let frame = |mode, piece: Range<usize>| Frame {
        mode,
        first: piece.start as u32,
        count: piece.len() as u32,
        ..frame
    };
    let made = (0..all)
        .step_by(MOST_RETURNS)
        .map(|first| frame(ALLOCATE, first..all.min(first + MOST_RETURNS)));
    let updated = if by_block {
        std::iter::once(0..all).collect()
    } else {
        pieces(weights, all, MOST_RETURNS, room)
    };
    let updated = updated.into_iter().filter(|piece| !piece.is_empty());
    Ok(made.chain(updated.map(|piece| frame(FUSE, piece))).collect())
}
