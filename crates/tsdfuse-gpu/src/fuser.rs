//! Fusing scans on the device, several in flight.

use std::collections::VecDeque;

use tsdfuse::{
    Scan, SensorModel, VoxelMap,
    fuse::{FuseConfig, FuseError, Method, Skipped},
    map::WEIGHT_SCALE,
};

use crate::device::GpuError;
use crate::flight::{FRAME_STRIDE, Flight};
use crate::frame::{ALLOCATE, FUSE, Frame};
use crate::map::{DeviceMap, Header};
use crate::method::{Prepare, Prepared};
use crate::shader::{Binding, FRAME, KEEP, source};

/// What became of a scan.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Fused {
    /// Its name.
    pub name: String,
    /// Blocks that were made or updated.
    pub updated_blocks: u64,
    /// Returns that reached the map.
    pub fused_returns: u64,
    /// Returns that could not be used, by reason.
    pub skipped: Skipped,
}

/// Fuses scans into a [`DeviceMap`].
///
/// Uploads, kernels and the CPU's share of the work overlap: a scan is reported a few scans after it was given.
#[derive(Debug)]
pub struct Fuser {
    map: DeviceMap,
    prepare: Prepare,
    allocate: wgpu::ComputePipeline,
    fuse: wgpu::ComputePipeline,
    /// Whether `fuse` has a workgroup for each block, not a thread for each return.
    by_block: bool,
    limit_weights: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
    /// Sent, the oldest first, with what the CPU left out.
    flights: VecDeque<(Flight, Skipped)>,
    idle: Vec<Flight>,
    /// To be reported.
    done: Vec<Fused>,
    scans: u32,
}

/// Scans that are under way at most.
const IN_FLIGHT: usize = 4;

/// Returns that one dispatch takes at most: 65 535 workgroups, which every device can do.
const MOST_RETURNS: usize = 65_535 * WORKGROUP as usize;

/// Threads in a workgroup.
const WORKGROUP: u32 = 64;

/// A voxel's sums fit 32 bits if its weight stays below this.
const MOST_WEIGHT: f32 = 65_535.0;

impl Fuser {
    /// Fuses into `map` by a method; `sensor` is the sensor's model, where it is known.
    ///
    /// # Errors
    /// [`GpuError::Unsupported`] for a method that does not run on the device.
    pub fn new(
        map: DeviceMap,
        method: Method,
        config: &FuseConfig,
        sensor: Option<&SensorModel>,
    ) -> Result<Self, GpuError> {
        config.validate()?;
        let (prepare, kernels) = Prepare::new(method, config, sensor)?;
        let gpu = &map.gpu;
        let layout = gpu.layout([Binding::Uniform(size_of::<Frame>() as u64), Binding::Read]);
        let groups = [&map.layout, &layout];
        let text = source(map.paging, &kernels.parts);
        let allocate = gpu.kernel(&text, kernels.allocate, &groups);
        let fuse = match kernels.fuse == kernels.allocate {
            true => allocate.clone(),
            false => gpu.kernel(&text, kernels.fuse, &groups),
        };
        let limit_weights = gpu.kernel(&source(map.paging, &[FRAME, KEEP]), "limit_weights", &groups);
        gpu.check()?;
        Ok(Self {
            prepare,
            allocate,
            fuse,
            by_block: kernels.by_block,
            limit_weights,
            layout,
            flights: VecDeque::new(),
            idle: Vec::new(),
            done: Vec::new(),
            scans: 0,
            map,
        })
    }

    /// Fuses a scan, and tells what became of one or more of those before, if that is known by now.
    ///
    /// # Errors
    /// [`GpuError::Fuse`] if the scan cannot be fused: the map is unchanged then, and others can follow. All else is the
    /// device's trouble, and scans that were not reported by then are not fused; unless it is [`GpuError::Lost`],
    /// [`Self::map`] still has the others.
    pub fn integrate(&mut self, scan: &Scan) -> Result<Vec<Fused>, GpuError> {
        scan.check().map_err(FuseError::from)?;
        while self.flights.len() >= IN_FLIGHT {
            self.finish_one()?;
        }
        self.scans = self.scans.wrapping_add(1).max(1);
        let prepared = self.prepare.prepare(scan)?;
        let frames = frames(&prepared, &self.map.empty, self.scans, self.by_block)?;
        let (old, gpu) = (self.idle.pop(), &self.map.gpu);
        let mut flight = Flight::load(old, gpu, &self.layout, &scan.name, frames, &prepared.columns())?;
        let skipped = prepared.skipped;
        self.send(&mut flight, true);
        self.flights.push_back((flight, skipped));
        Ok(std::mem::take(&mut self.done))
    }

    /// Waits for all scans, and tells what became of those that were not reported yet.
    ///
    /// # Errors
    /// As [`Self::integrate`].
    pub fn finish(&mut self) -> Result<Vec<Fused>, GpuError> {
        while !self.flights.is_empty() {
            self.finish_one()?;
        }
        Ok(std::mem::take(&mut self.done))
    }

    /// The map; scans that are under way may be in it or not.
    pub fn map(&self) -> &DeviceMap {
        &self.map
    }

    /// The map, once all scans are in it.
    ///
    /// # Errors
    /// As [`Self::integrate`].
    pub fn into_map(mut self) -> Result<DeviceMap, GpuError> {
        self.finish()?;
        Ok(self.map)
    }

    /// Sends a scan's kernels; its returns only the first time.
    fn send(&self, flight: &mut Flight, is_first: bool) {
        let gpu = &self.map.gpu;
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        if is_first {
            flight.upload(&mut encoder);
        }
        encoder.clear_buffer(self.map.state(), Header::SCAN, Some(Header::BYTES - Header::SCAN));
        for (offset, frame) in (0..).step_by(FRAME_STRIDE as usize).zip(&flight.frames) {
            let mut dispatch = |name, kernel, workgroups| {
                let mut pass = gpu.pass(&mut encoder, name);
                pass.set_bind_group(0, &self.map.bind_group, &[]);
                pass.set_bind_group(1, &flight.bind_group, &[offset]);
                pass.set_pipeline(kernel);
                pass.dispatch_workgroups(workgroups, 1, 1);
            };
            let workgroups = frame.count.div_ceil(WORKGROUP);
            if frame.mode == FUSE {
                let by_block = self.map.capacity().min(BY_BLOCK);
                dispatch("fuse", &self.fuse, if self.by_block { by_block } else { workgroups });
                dispatch("limit_weights", &self.limit_weights, self.map.capacity().min(BY_BLOCK));
            } else {
                dispatch("allocate", &self.allocate, workgroups);
            }
        }
        flight.submit(gpu, encoder, self.map.state(), is_first);
    }

    /// Waits for the oldest scan. If there was no room for it, makes some and repeats all scans since.
    fn finish_one(&mut self) -> Result<(), GpuError> {
        while let Some((flight, _)) = self.flights.front() {
            let header = flight.wait(&self.map.gpu)?;
            if header.flags == 0 {
                return self.report(header);
            }
            for (later, _) in self.flights.iter().skip(1) {
                later.wait(&self.map.gpu)?;
            }
            if let Err(error) = self.map.make_room(header) {
                self.flights.clear();
                return Err(error);
            }
            let mut flights = std::mem::take(&mut self.flights);
            flights.iter_mut().for_each(|(flight, _)| self.send(flight, false));
            self.flights = flights;
        }
        Ok(())
    }

    fn report(&mut self, header: Header) -> Result<(), GpuError> {
        let Some((flight, mut skipped)) = self.flights.pop_front() else {
            return Ok(());
        };
        skipped.outside_grid += u64::from(header.outside_grid);
        skipped.without_normal += u64::from(header.without_normal);
        skipped.without_weight += u64::from(header.without_weight);
        let name = flight.name.clone();
        self.idle.push(flight);
        if header.lost > 0 {
            let lost = header.lost;
            let why = format!("{name}: {lost} updates found no block, since two runs of one kernel differ");
            return Err(GpuError::Driver(why));
        }
        self.done.push(Fused {
            name,
            updated_blocks: header.updated.into(),
            fused_returns: header.fused.into(),
            skipped,
        });
        Ok(())
    }
}

/// What each dispatch is told: first those that make blocks, then those that update.
fn frames(prepared: &Prepared<'_>, map: &VoxelMap, stamp: u32, by_block: bool) -> Result<Vec<Frame>, GpuError> {
    let (all, weight) = (prepared.items, prepared.weight);
    let mut frame = Frame::of(&prepared.scan, map)?;
    frame.stamp = stamp;
    prepared.place_columns(&mut frame);
    // No voxel's sums may overflow before its weight is limited again.
    let room = MOST_WEIGHT - map.config().max_weight;
    let piece = match weight <= room {
        true if by_block => usize::MAX,
        true => MOST_RETURNS,
        false => room as usize,
    };
    // A return adds 1 at most, and rounding half a unit.
    let most_sum = ((weight.min(piece as f32) * WEIGHT_SCALE as f32).ceil() as u32).saturating_add(all as u32);
    frame.heavy_sum = frame.max_weight_sum.saturating_sub(most_sum);
    let pieces = |mode, most: usize| {
        (0..all).step_by(most).map(move |first| Frame {
            mode,
            first: first as u32,
            count: most.min(all - first) as u32,
            ..frame
        })
    };
    Ok(pieces(ALLOCATE, MOST_RETURNS).chain(pieces(FUSE, piece)).collect())
}

/// Workgroups that take blocks in turns.
const BY_BLOCK: u32 = 4096;
