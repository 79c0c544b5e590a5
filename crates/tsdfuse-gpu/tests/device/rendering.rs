//! Views rendered on the device, against the CPU's of the same map.

use tsdfuse::{
    MapConfig, Pose, VoxelMap,
    glam::{DQuat, DVec3, EulerRot},
    render::{Camera, RenderConfig, RenderError, View, render},
    sensor::{Pinhole, model},
};
use tsdfuse_gpu::{DeviceMap, GpuError, Renderer};

use crate::{
    gpu,
    map::{SMALL, room_of},
};

/// The share of pixels that see other surface: on one side only, or more than 1/100 voxel apart, or turned otherwise. Where a ray
/// just grazes an edge, rounding decides what it hits.
fn differing(a: &View, b: &View, voxel_m: f32) -> f64 {
    assert_eq!((a.width, a.height), (b.width, b.height));
    let differ = a.hits.iter().zip(&b.hits).filter(|(a, b)| match (a, b) {
        (None, None) => false,
        (Some(a), Some(b)) => {
            let far = 1.0 + 1e-4 * (a.range_m / voxel_m);
            (a.range_m - b.range_m).abs() > 0.01 * voxel_m * far
                || (a.depth_m - b.depth_m).abs() > 0.01 * voxel_m * far
                || a.normal.distance(b.normal) > 0.02
                || (a.incidence_cos - b.incidence_cos).abs() > 0.02
                || (a.weight - b.weight).abs() > 0.01 * b.weight
        }
        _ => true,
    });
    differ.count() as f64 / a.hits.len() as f64
}

const SHARE: f64 = 5e-4;

fn views() -> Vec<(Camera, Pose)> {
    let pinhole = Camera::Pinhole(Pinhole::with_fov(96, 64, 1.4));
    let lidar = Camera::Lidar(model("vlp16").unwrap());
    let mut views = Vec::new();
    for n in 0..3 {
        let angle = f64::from(n);
        let pose = Pose {
            rotation: DQuat::from_euler(EulerRot::ZYX, 1.3 * angle, 0.2 * angle, 0.1),
            translation: DVec3::new(0.4 * angle - 0.5, 0.1, 0.2 * angle),
        };
        views.extend([(pinhole.clone(), pose), (lidar.clone(), pose)]);
    }
    // From above, through the ceiling, and away from everything.
    let above = DVec3::new(0.0, 0.1, 9.0);
    let down = |pitch| Pose {
        rotation: DQuat::from_rotation_y(pitch),
        translation: above,
    };
    views.extend([(pinhole.clone(), down(1.5)), (pinhole, down(-1.0))]);
    views
}

#[test]
fn pinhole_and_lidar_see_what_the_cpu_sees() {
    let Some(gpu) = gpu() else { return };
    let map = room_of(60_000);
    let device = DeviceMap::upload(gpu, &map, SMALL).unwrap();
    let config = RenderConfig::default();
    let mut renderer = Renderer::new(&device, &config).unwrap();
    let mut seen = Vec::new();
    for (camera, pose) in views() {
        let (got, want) = (
            renderer.view(&device, &camera, pose).unwrap(),
            render(&map, &camera, pose, &config).unwrap(),
        );
        let share = differing(&got, &want, 0.05);
        eprintln!(
            "{} of {} pixels see surface, {share:.2e} differ",
            want.hit_count(),
            want.hits.len()
        );
        assert!(share <= SHARE, "{share}");
        seen.push(want.hit_count() as f64 / want.hits.len() as f64);
        // The comparison sees other surface.
        let mut off = got.clone();
        off.hits.iter_mut().flatten().for_each(|hit| hit.range_m += 0.002);
        assert!(want.hit_count() == 0 || differing(&off, &want, 0.05) > SHARE);
    }
    assert!(
        seen[0] > 0.7 && seen[1] > 0.7 && seen[6] > 0.2 && seen[7] == 0.0,
        "{seen:?}"
    );
    // From another pose.
    let [(camera, a), _, (_, b), ..] = &views()[..] else {
        panic!()
    };
    let apart = differing(
        &renderer.view(&device, camera, *a).unwrap(),
        &render(&map, camera, *b, &config).unwrap(),
        0.05,
    );
    assert!(apart > 0.5, "{apart}");
}

#[test]
fn weights_and_ranges_limit_what_is_seen_as_on_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let map = room_of(60_000);
    let device = DeviceMap::upload(gpu, &map, SMALL).unwrap();
    for config in [
        RenderConfig {
            min_weight: 12.0,
            ..Default::default()
        },
        RenderConfig {
            max_range_m: 2.2,
            ..Default::default()
        },
    ] {
        let (camera, pose) = views().remove(0);
        let want = render(&map, &camera, pose, &config).unwrap();
        let all = render(&map, &camera, pose, &RenderConfig::default()).unwrap();
        let got = Renderer::new(&device, &config)
            .unwrap()
            .view(&device, &camera, pose)
            .unwrap();
        assert!(differing(&got, &want, 0.05) <= SHARE);
        assert!(differing(&got, &all, 0.05) > 0.05);
    }
}

#[test]
fn what_cannot_be_seen_is_nothing_and_what_makes_no_sense_is_refused() {
    let Some(gpu) = gpu() else { return };
    let device = DeviceMap::upload(gpu, &VoxelMap::new(MapConfig::default()).unwrap(), SMALL).unwrap();
    let mut renderer = Renderer::new(&device, &RenderConfig::default()).unwrap();
    let (camera, pose) = views().remove(0);
    assert_eq!(renderer.view(&device, &camera, pose).unwrap().hit_count(), 0);
    let outside = Pose {
        translation: DVec3::splat(1e12),
        ..pose
    };
    let told = renderer.view(&device, &camera, outside);
    assert!(matches!(told, Err(GpuError::Render(RenderError::Outside(_)))));
    let no_camera = Camera::Pinhole(Pinhole {
        width: 0,
        ..Pinhole::with_fov(9, 9, 1.0)
    });
    assert!(matches!(
        renderer.view(&device, &no_camera, pose),
        Err(GpuError::Render(_))
    ));
}
