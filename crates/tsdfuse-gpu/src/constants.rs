//! The tuning constants of the CPU's methods, as constants of the kernels.

use std::fmt::Debug;
use std::sync::LazyLock;

use tsdfuse::fuse::twin;

/// Names are those of [`twin`]; the two values of a pair have names of their own.
pub(crate) static CONSTANTS: LazyLock<String> = LazyLock::new(|| {
    fn text<T: Debug>(kind: &str, list: &[(&str, T)]) -> String {
        let line = |(name, value): &(&str, T)| format!("const {name}: {kind} = {value:?};\n");
        list.iter().map(line).collect()
    }
    macro_rules! named {
        ($($name:ident)*) => { [$((stringify!($name), twin::$name)),*] };
    }
    let [least, most] = twin::NOISE_M;
    let [turns, turns_updated] = twin::TURNS;
    let lengths = named!(MIN_RETURNS MAX_RESIDUAL MAX_OFF ROUGHNESS_M MIN_SPREAD MIN_COSINE MIN_TELLING FACING MIN_DOT
        MAX_OFF_BETWEEN COPLANAR_GAPS COPLANAR_LENGTH_M COPLANAR_OFF_M COPLANAR_DOT FRONT BEHIND FULL_BEHIND RAY_WEIGHT FAR_M MAX_GAP_OF_RANGE MAX_GAP_ACROSS_M INSIDE BESIDE MARGIN BINS_PER_RAD SAME_FIRING
        AGREES KNOWN OTHER_SURFACE LEAST_LINES OF_MEDIAN BLUR SIGMAS HALVING SIGMAS_OF_RAYS);
    let counts =
        named!(MAX_RINGS MAX_COLUMNS SAMPLE MIN_PASSED PHASE_BINS LOOK OWN_STEPS OTHER_STEPS ARMS BINS_PER_VOXEL)
            .map(|(name, count)| (name, count as u32));
    let others = [
        ("FORGOTTEN", twin::FORGOTTEN),
        ("LEAST_OFFSETS", twin::LEAST_OFFSETS),
        ("MOST_TIMES", twin::MOST_TIMES),
        ("TURNS", turns),
        ("TURNS_UPDATED", turns_updated),
    ];
    [
        text("f32", &lengths),
        text("f32", &[("LEAST_NOISE_M", least), ("MOST_NOISE_M", most)]),
        text("u32", &counts),
        text("u32", &others),
        text("i32", &named!(LEFT)),
    ]
    .concat()
});
