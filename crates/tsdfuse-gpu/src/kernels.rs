//! The kernels of a method, in the order in which a scan goes through them.

use crate::constants::CONSTANTS;
use crate::frame::Frame;
use crate::shader::{
    ANGLES, CARVE, CYLINDER, CYLINDRICAL, DEPTH, EUCLIDEAN, FRAME, IMAGE, LINES, NORMALS, ONE_LINE, PATCH, PHASES,
    PIXELS, PLANES,
};

/// A kernel, and how much of it runs.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Step {
    /// What timelines call it.
    pub(crate) name: &'static str,
    /// Its name in the source.
    pub(crate) entry: &'static str,
    pub(crate) work: Work,
}

/// What a kernel has threads or workgroups for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Work {
    /// So many threads for each return (or pixel) of a dispatch.
    Returns(u32),
    /// Threads that take returns of the whole scan in turns.
    Scan,
    /// Threads that take cells of the organized image in turns.
    Cells,
    /// Workgroups that take blocks in turns.
    Blocks,
    /// One workgroup.
    Once,
}

/// Threads in a workgroup.
pub(crate) const WORKGROUP: u32 = 64;

/// Workgroups that take things in turns.
const IN_TURNS: u32 = 4096;

impl Work {
    /// Workgroups for a frame, and a map with room for so many blocks.
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
    /// What comes before all others, once a scan.
    pub(crate) before: Vec<Step>,
    /// Makes blocks.
    pub(crate) allocate: Step,
    /// Updates them.
    pub(crate) fuse: Step,
    /// What comes after all others, once a scan.
    pub(crate) after: Vec<Step>,
}

impl Kernels {
    /// Those that walk along lines, so many threads a return.
    fn lines(threads: u32, parts: &[&'static str]) -> Self {
        // One kernel does both, so that both see the very same voxels.
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

    /// One line a return.
    pub(crate) fn one_line(parts: &[&'static str]) -> Self {
        Self::lines(1, &[&[ONE_LINE], parts].concat())
    }

    /// Those of depth images.
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

    /// Those of cylindrical images.
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

    /// Those of local normals.
    pub(crate) fn normals() -> Self {
        Self {
            before: image(),
            ..Self::one_line(&[&CONSTANTS, ANGLES, PHASES, IMAGE, CYLINDER, NORMALS])
        }
    }

    /// Those of surface patches, where noise is estimated and free space erases, or not.
    pub(crate) fn patch(estimates_noise: bool, carves: bool) -> Self {
        let mut before = image();
        if estimates_noise {
            before.extend([step("sample_noise", Work::Scan), step("choose_noise", Work::Once)]);
        }
        before.push(step("find_planes", Work::Cells));
        Self {
            before,
            after: carves.then(|| step("carve", Work::Blocks)).into_iter().collect(),
            ..Self::lines(3, &[&CONSTANTS, ANGLES, PHASES, IMAGE, PLANES, CYLINDER, PATCH, CARVE])
        }
    }
}

/// A kernel that has the same name everywhere.
const fn step(name: &'static str, work: Work) -> Step {
    Step {
        name,
        entry: name,
        work,
    }
}

/// Those that make the organized image.
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

/// Limits the weights of what a scan updated.
pub(crate) const LIMIT_WEIGHTS: Step = step("limit_weights", Work::Blocks);
