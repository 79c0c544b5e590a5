//! Tests, which need no GPU, of what host and kernels must agree on: kernels are parsed, and their structs and constants are
//! compared with those of the host and of the CPU's map.

use std::mem::offset_of;

use naga::{
    Module, TypeInner,
    valid::{Capabilities, ValidationFlags, Validator},
};
use tsdfuse::{
    fuse::{FuseConfig, Method, twin},
    index::BLOCK_VOXELS,
    map::WEIGHT_SCALE,
    sensor::approx::{acos_f32, atan2_f32},
};

use crate::{
    constants::CONSTANTS,
    frame::{ALLOCATE, FUSE, Frame},
    map::{Header, POOL_FULL},
    method::{METHODS, Prepare},
    prepared::{CELL_BYTES, OFFER_BYTES, PATCH_BYTES, PLACE_BYTES, RING_BYTES, SEEN_BYTES},
    render,
    scratch::Scratch,
    shader::{ANGLES, FIND_SURFACE, FRAME, GATHER, KEEP, LINES, Paging, RENDER, SURFACE, WRITE_MESH, source},
    surface::Params,
    sweep::Segment,
};

const PAGING: Paging = Paging { pages: 3, shift: 5 };

/// All kernels, by name.
fn sources() -> Vec<(String, String)> {
    let mut all = vec![("keep".to_owned(), source(PAGING, &[FRAME, KEEP]))];
    all.push(("gather".to_owned(), source(PAGING, &[GATHER])));
    all.push(("find_surface".to_owned(), source(PAGING, &[SURFACE, FIND_SURFACE])));
    all.push(("write_mesh".to_owned(), source(PAGING, &[SURFACE, WRITE_MESH])));
    all.push(("render".to_owned(), source(PAGING, &[SURFACE, RENDER])));
    for method in METHODS {
        let (_, kernels) = Prepare::new(method, &FuseConfig::default(), None).unwrap();
        all.push((method.name().to_owned(), source(PAGING, &kernels.parts)));
    }
    all
}

fn parse(source: &str) -> Module {
    naga::front::wgsl::parse_str(source).unwrap_or_else(|e| panic!("{}", e.emit_to_string(source)))
}

/// The members of a struct: name and offset.
fn members(module: &Module, name: &str) -> Vec<(String, usize)> {
    let found = module.types.iter().find(|(_, t)| t.name.as_deref() == Some(name));
    let Some(TypeInner::Struct { members, .. }) = found.map(|(_, t)| &t.inner) else {
        panic!("there is no struct {name}");
    };
    members
        .iter()
        .map(|m| (m.name.clone().unwrap_or_default(), m.offset as usize))
        .collect()
}

/// The value of a constant in the source.
fn constant(source: &str, name: &str) -> f64 {
    let head = format!("const {name}: ");
    let line = source.lines().find(|line| line.starts_with(&head));
    let value = line
        .and_then(|line| line.split("= ").nth(1))
        .unwrap_or_else(|| panic!("no constant {name}"));
    let digits = value.trim_end_matches([';', 'u']);
    match digits.strip_prefix("0x") {
        Some(hex) => f64::from(u32::from_str_radix(hex, 16).unwrap()),
        None => digits.parse().unwrap(),
    }
}

#[test]
fn all_kernels_are_valid() {
    for (name, source) in sources() {
        let module = parse(&source);
        Validator::new(ValidationFlags::all(), Capabilities::empty())
            .validate(&module)
            .unwrap_or_else(|e| panic!("{name}: {}", e.emit_to_string(&source)));
    }
}

macro_rules! layout {
    ($type:ty: $($field:ident)*) => {
        vec![$((stringify!($field).to_owned(), offset_of!($type, $field))),*]
    };
}

fn frame_layout() -> Vec<(String, usize)> {
    layout!(Frame: world_x mode world_y first world_z count anchor_voxel stamp anchor_fraction voxels_per_m
        truncation_vox max_weight_sum heavy_sum times_at segments_at segments rings_at rings columns max_range_m min_dot
        total window_m noise_m step_m max_gap_m column_rad columns_per_rad gaps_at nearest_at towards_at top per_pitch crowd
        neighbour_cells camera)
}

#[test]
fn frames_have_one_layout() {
    let source = source(PAGING, &[FRAME, KEEP]);
    assert_eq!(members(&parse(&source), "Frame"), frame_layout());
    assert_eq!(frame_layout().last().unwrap().1 + 16, size_of::<Frame>());
    // The comparison detects two swapped fields.
    let swapped = source
        .replace("voxels_per_m: f32", "x: f32")
        .replace("truncation_vox: f32", "voxels_per_m: f32");
    let swapped = swapped.replace(" x: f32,", " truncation_vox: f32,");
    assert_ne!(members(&parse(&swapped), "Frame"), frame_layout());
}

#[test]
fn parameters_have_one_layout() {
    let want = layout!(Params: blocks min_sum first count first_vertex first_triangle);
    assert_eq!(
        members(&parse(&source(PAGING, &[SURFACE, FIND_SURFACE])), "Surface"),
        want
    );
}

#[test]
fn segments_have_one_layout() {
    let source = source(PAGING, &[FRAME, KEEP]);
    for (name, offset) in [
        ("UNTIL_SECS", offset_of!(Segment, until_secs)),
        ("FROM_SECS", offset_of!(Segment, from_secs)),
        ("TURN_RATE", offset_of!(Segment, turn_rate)),
        ("SHIFT", offset_of!(Segment, shift)),
        ("VELOCITY", offset_of!(Segment, velocity)),
        ("TURN_AXIS", offset_of!(Segment, turn_axis)),
        ("ROTATION", offset_of!(Segment, rotation)),
        ("SEGMENT_WORDS", size_of::<Segment>()),
    ] {
        assert_eq!(4.0 * constant(&source, name), offset as f64, "{name}");
    }
}

#[test]
fn views_and_hits_have_one_layout() {
    let module = parse(&source(PAGING, &[SURFACE, RENDER]));
    let view = layout!(render::Params: base width origin height world_x max_range_vox world_y voxel_size_m world_z pad
        low pad_low high pad_high);
    assert_eq!(members(&module, "View"), view);
    let hit = layout!(render::DeviceHit: normal range_m depth_m incidence_cos weight pad);
    assert_eq!(members(&module, "Hit"), hit);
}

/// Bytes from one entry of the list of updated blocks to the next.
fn state_list_stride() -> u32 {
    let module = parse(&source(PAGING, &[]));
    let state = module.types.iter().find(|(_, t)| t.name.as_deref() == Some("State"));
    let Some(TypeInner::Struct { members, .. }) = state.map(|(_, t)| &t.inner) else {
        panic!("there is no struct State");
    };
    let list = members.iter().find(|m| m.name.as_deref() == Some("list")).unwrap();
    match module.types[list.ty].inner {
        TypeInner::Array { stride, .. } => stride,
        ref other => panic!("{other:?}"),
    }
}

#[test]
fn the_state_has_one_layout() {
    let state = members(&parse(&source(PAGING, &[])), "State");
    let offset = |name: &str| state.iter().find(|(n, _)| n == name).unwrap().1 as u64;
    assert_eq!((offset("updated"), offset("table_mask")), (Header::SCAN, Header::SIZES));
    assert_eq!(
        (offset("table_mask"), offset("capacity"), offset("list")),
        (Header::SIZES, Header::SIZES + 4, Header::LIST)
    );
    let list = state_list_stride();
    assert_eq!(u64::from(list), Header::ENTRY);
    // Each counter is read from the offset that it is written to.
    let words: Vec<u8> = (1_u32..=10).flat_map(u32::to_le_bytes).collect();
    let header = Header::parse(&words);
    let named = [
        ("flags", header.flags),
        ("blocks", header.blocks),
        ("updated", header.updated),
        ("fused", header.fused),
        ("outside_grid", header.outside_grid),
        ("without_normal", header.without_normal),
        ("without_weight", header.without_weight),
        ("outside_image", header.outside_image),
        ("hidden", header.hidden),
        ("lost", header.lost),
    ];
    for (name, word) in named {
        assert_eq!(offset(name), 4 * u64::from(word - 1), "{name}");
    }
}

#[test]
fn constants_are_the_same() {
    let source = source(PAGING, &[FRAME, LINES, KEEP]);
    for (name, value) in [
        ("WEIGHT_SCALE", f64::from(WEIGHT_SCALE)),
        ("BLOCK_VOXELS", BLOCK_VOXELS as f64),
        ("POOL_FULL", f64::from(POOL_FULL)),
        ("ALLOCATE", f64::from(ALLOCATE)),
        ("FUSE", f64::from(FUSE)),
    ] {
        assert_eq!(constant(&source, name), value, "{name}");
    }
    assert!((constant(&source, "VOXEL_RADIUS") - 0.75_f64.sqrt()).abs() < 1e-7);
}

#[test]
fn methods_that_do_not_run_there_are_refused_by_name() {
    for &method in Method::ALL {
        let made = Prepare::new(method, &FuseConfig::default(), None);
        assert_eq!(made.is_ok(), METHODS.contains(&method));
        if let Err(error) = made {
            assert!(error.to_string().starts_with(method.name()), "{error}");
        }
    }
}

/// The numbers of an array in the source of angles.
fn coefficients(name: &str) -> Vec<f32> {
    let list = ANGLES.split(&format!("const {name} = array(")).nth(1);
    let numbers = list.and_then(|rest| rest.split(')').next()).unwrap().split(',');
    let numbers = numbers.map(str::trim).filter(|number| !number.is_empty());
    numbers.map(|number| number.parse().unwrap()).collect()
}

fn polynomial(coefficients: &[f32], x: f32) -> f32 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

/// Asserts that a function of these coefficients is the CPU's, and that another one would not be.
fn assert_same(mut coefficients: Vec<f32>, function: impl Fn(&[f32], f32) -> f32, of_cpu: impl Fn(f32) -> f32) {
    let places = || (-1000..=1000).map(|i| i as f32 * 1e-3);
    let differing = |c: &[f32]| places().filter(|&x| function(c, x) != of_cpu(x)).count();
    assert_eq!(differing(&coefficients), 0);
    coefficients[3] += 1e-6;
    assert!(differing(&coefficients) > 100);
}

#[test]
fn angles_are_the_cpus() {
    let arc_cosine = |c: &[f32], x: f32| {
        let angle = (1.0 - x.abs()).sqrt() * polynomial(c, x.abs());
        if x < 0.0 { std::f32::consts::PI - angle } else { angle }
    };
    assert_same(coefficients("ACOS"), arc_cosine, acos_f32);
    let arc_tangent = |c: &[f32], x: f32| x * polynomial(c, x * x);
    assert_same(coefficients("ATAN"), arc_tangent, |x| atan2_f32(x, 1.0));
}

#[test]
fn what_is_tuned_on_the_cpu_is_tuned_here() {
    let source = CONSTANTS.as_str();
    for (name, value) in [
        ("FRONT", twin::FRONT),
        ("MAX_OFF_BETWEEN", twin::MAX_OFF_BETWEEN),
        ("MOST_NOISE_M", twin::NOISE_M[1]),
        ("TURNS_UPDATED", twin::TURNS[1] as f32),
        ("LOOK", twin::LOOK as f32),
        ("MAX_COLUMNS", twin::MAX_COLUMNS as f32),
    ] {
        assert_eq!(constant(source, name) as f32, value, "{name}");
    }
}

#[test]
fn what_is_counted_and_offered_is_forgotten_before_the_next_scan() {
    let cleared = |method: Method| {
        let (_, kernels) = Prepare::new(method, &FuseConfig::default(), None).unwrap();
        let module = parse(&source(PAGING, &kernels.parts));
        // The first two bindings are the frame and the returns.
        let place = |v: &naga::GlobalVariable| v.binding.filter(|at| at.group == 1).map(|at| at.binding as usize);
        let is_cleared = |at: usize| at.checked_sub(2).is_some_and(|at| Scratch::CLEARED.contains(&at));
        let variables = module.global_variables.iter().map(|(_, v)| v);
        let found = variables.filter(|v| place(v).is_some_and(is_cleared));
        let mut names: Vec<String> = found.filter_map(|v| v.name.clone()).collect();
        names.sort();
        names
    };
    assert_eq!(cleared(Method::Normals), ["offers", "rings"]);
    assert_eq!(cleared(Method::Patch), ["offers", "rings"]);
    assert_eq!(cleared(Method::Cylindrical), ["pixels", "rings"]);
    assert_eq!(cleared(Method::Depth), ["pixels"]);
    assert!(cleared(Method::Raycast).is_empty());
}

#[test]
fn what_kernels_leave_to_each_other_has_one_size() {
    for (method, name, bytes) in [
        (Method::Patch, "Cell", CELL_BYTES),
        (Method::Patch, "Place", PLACE_BYTES),
        (Method::Patch, "Offer", OFFER_BYTES),
        (Method::Patch, "Ring", RING_BYTES),
        (Method::Patch, "Patch", PATCH_BYTES),
        (Method::Cylindrical, "Seen", SEEN_BYTES),
    ] {
        let (_, kernels) = Prepare::new(method, &FuseConfig::default(), None).unwrap();
        let module = parse(&source(PAGING, &kernels.parts));
        let found = module.types.iter().find(|(_, t)| t.name.as_deref() == Some(name));
        let Some(TypeInner::Struct { span, .. }) = found.map(|(_, t)| &t.inner) else {
            panic!("there is no struct {name}");
        };
        assert_eq!(u64::from(*span), bytes, "{name}");
    }
}
