//! The kernels of each method, in the order in which they run.

use crate::constants::CONSTANTS;
use crate::frame::Frame;
use crate::shader::{
    AGREEMENT, ANGLES, CARVE, CYLINDER, CYLINDRICAL, DEPTH, EUCLIDEAN, FRAME, IMAGE, LINES, NORMALS, ONE_LINE, PATCH,
    PHASES, PIXELS, PLANES, SETTLED,
};

/// A kernel, and how many of its workgroups run.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Step {
    /// Its name in timelines.
    pub(crate) name: &'static str,
    /// Its name in the source.
    pub(crate) entry: &'static str,
    pub(crate) work: Work,
}

/// What determines the number of workgroups of a kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Work {
    /// This many threads for each return (or pixel) of a dispatch.
    Returns(u32),
    /// Threads that share the returns of the whole scan.
    Scan,
    /// Threads that share the cells of the organized image.
    Cells,
    /// Workgroups that share the blocks of the map.
    Blocks,
    /// One workgroup.
    Once,
}

/// Threads in a workgroup.
pub(crate) const WORKGROUP: u32 = 64;

/// The most workgroups of a kernel that loops over its work.
const IN_TURNS: u32 = 4096;

impl Work {
    /// Workgroups for a frame and a map of this capacity.
    pub(crate) fn workgroups(self, frame: &Frame, capacity: u32) -> u32 {
        match self {
            Self::Returns(threads) => threads * frame.count.div_ceil(WORKGROUP),
            Self::Scan => frame.total.div_ceil(WORKGROUP).min(IN_TURNS),
            Self::Cells => (frame.rings * frame.columns).div_ceil(WORKGROUP).min(IN_TURNS),
            Self::Blocks => capacity.min(IN_TURNS),
            Self::Once => 1,
        }
    }
}

/// The kernels of a method.
#[derive(Debug)]
pub(crate) struct Kernels {
    /// Their source.
    pub(crate) parts: Vec<&'static str>,
    /// Run once a scan, before all others.
    pub(crate) before: Vec<Step>,
    /// Creates blocks.
    pub(crate) allocate: Step,
    /// Updates them.
    pub(crate) fuse: Step,
    /// Run once a scan, after all others.
    pub(crate) after: Vec<Step>,
}

impl Kernels {
    /// Methods that walk along lines, with this many threads per return.
    fn lines(threads: u32, parts: &[&'static str]) -> Self {
        // One kernel does both, so both see exactly the same voxels.
        let step = |name| Step {
            name,
            entry: "fuse",
            work: Work::Returns(threads),
        };
        Self {
            parts: [FRAME, LINES].iter().chain(parts).copied().collect(),
            before: Vec::new(),
            allocate: step("allocate"),
            fuse: step("fuse"),
            after: Vec::new(),
        }
    }

    /// Methods with one line per return.
    pub(crate) fn one_line(parts: &[&'static str]) -> Self {
        Self::lines(1, &[&[ONE_LINE], parts].concat())
    }

    /// Depth images.
    pub(crate) fn depth() -> Self {
        Self {
            parts: vec![FRAME, PIXELS, DEPTH],
            before: vec![step("find_depths", Work::Scan)],
            allocate: Step {
                entry: "allocate_depth",
                ..step("allocate", Work::Returns(1))
            },
            fuse: Step {
                entry: "fuse_depth",
                ..step("fuse", Work::Blocks)
            },
            after: Vec::new(),
        }
    }

    /// Cylindrical images.
    pub(crate) fn cylindrical() -> Self {
        Self {
            before: vec![
                step("count_parts", Work::Scan),
                step("find_phase", Work::Once),
                step("offer_pixels", Work::Scan),
                step("choose_nearest", Work::Scan),
            ],
            ..Self::one_line(&[&CONSTANTS, ANGLES, PHASES, PIXELS, EUCLIDEAN, CYLINDRICAL])
        }
    }

    /// Local normals.
    pub(crate) fn normals() -> Self {
        Self {
            before: image(),
            ..Self::one_line(&[&CONSTANTS, ANGLES, PHASES, IMAGE, CYLINDER, NORMALS])
        }
    }

    /// Surface patches, with or without estimating noise, erasing, and following how well scans agree with the map.
    pub(crate) fn patch(estimates_noise: bool, carves: bool, agreement: bool) -> Self {
        let mut before = image();
        if estimates_noise {
            before.extend([step("sample_noise", Work::Scan), step("choose_noise", Work::Once)]);
        }
        before.push(step("find_planes", Work::Cells));
        let mut after = Vec::new();
        if carves && agreement {
            before.extend([
                step("sample_offsets", Work::Scan),
                step("choose_agreement", Work::Once),
                step("find_turns", Work::Cells),
            ]);
            after.push(step("mark_waiting", Work::Cells));
        }
        if carves {
            after.push(step("carve", Work::Blocks));
        }
        Self {
            before,
            after,
            ..Self::lines(
                3,
                &[
                    &CONSTANTS, ANGLES, PHASES, IMAGE, PLANES, AGREEMENT, CYLINDER, PATCH, SETTLED, CARVE,
                ],
            )
        }
    }
}

/// A kernel whose name in timelines is its name in the source.
const fn step(name: &'static str, work: Work) -> Step {
    Step {
        name,
        entry: name,
        work,
    }
}

/// The kernels that make the organized image.
fn image() -> Vec<Step> {
    vec![
        step("find_azimuths", Work::Scan),
        step("find_phases", Work::Cells),
        step("offer_cells", Work::Scan),
        step("choose_nearest", Work::Scan),
        step("move_aside", Work::Scan),
        step("place_cells", Work::Cells),
    ]
}

/// Limits the weights of the blocks that a scan updated.
pub(crate) const LIMIT_WEIGHTS: Step = step("limit_weights", Work::Blocks);
