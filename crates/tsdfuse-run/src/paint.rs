//! Colours of a surface, from the cameras of a log.
//!
//! ```text
//!   each image ─▶ which vertices it sees: the surface itself hides the others
//!              ─▶ how bright it is against the others, where they see the same      (exposure)
//!              ─▶ its colour for each vertex, weighted: near and frontal views count most
//! ```

use std::collections::BTreeMap;

use rayon::prelude::*;
use tsdfuse::glam::{DVec3, Vec3};
use tsdfuse::sensor::Pinhole;
use tsdfuse::{Mesh, Pose};
use tsdfuse_io::photo::{self, Photo};
use tsdfuse_io::{ImageRef, Log};

use crate::error::{Result, RunError};
use crate::event::{Event, Observer};

/// The colour of vertices that no image sees.
pub const UNSEEN: [u8; 3] = [150, 150, 150];

/// Pixels of an image per pixel of the view that tells what is hidden, along an edge.
const COARSER: u32 = 4;

/// A vertex this many voxels behind what the camera sees first is hidden.
const BEHIND_VOXELS: f32 = 3.0;

/// Surface farther from the camera than this gets no colour: a pixel is then as large as a few voxels.
const FARTHEST_M: f32 = 80.0;

/// The least cosine between the normal and the way to the camera: a road is seen up to some 50 m away.
const LEAST_COS: f32 = 0.03;

/// Vertices that no image sees take the colour of those beside them, over so many edges: where surface is grazed, noise hides every other
/// vertex.
const SPREAD_EDGES: usize = 3;

/// Vertices that exposures are found from, about.
const SAMPLES: usize = 20_000;

/// Rounds of finding exposures: they converge quickly.
const ROUNDS: usize = 20;

/// Brightness at which an image tells nothing about its exposure: black or burnt out.
const DARK: f32 = 12.0;
/// See [`DARK`].
const BRIGHT: f32 = 243.0;

/// Colours of a mesh.
#[derive(Clone, Debug, Default)]
pub struct Painted {
    /// sRGB of each vertex.
    pub colors: Vec<[u8; 3]>,
    /// Vertices that some image sees, or sees beside them; the others are [`UNSEEN`].
    pub seen: usize,
    /// Images that were used.
    pub images: usize,
    /// The gain of each of these.
    pub gains: Vec<f32>,
}

/// An image that can be projected.
struct Shot<'a> {
    image: &'a ImageRef,
    camera_from_world: Pose,
    eye: DVec3,
    depths: Depths,
}

/// Finds the colours of a mesh of voxels of this size.
///
/// # Errors
/// [`RunError::Config`] if the log has no images with known poses; if an image cannot be read.
pub fn paint(mesh: &Mesh, voxel_size_m: f64, log: &Log, observer: &mut dyn Observer) -> Result<Painted> {
    let usable = |(index, image): (usize, &'_ ImageRef)| image.pose.map(|_| index);
    let usable: Vec<usize> = log.images().iter().enumerate().filter_map(usable).collect();
    if usable.is_empty() {
        return Err(RunError::config(
            "colours need images of cameras whose poses and intrinsics the log tells; this log has none",
        ));
    }
    observer.on(Event::Working("colouring"));
    let behind_m = BEHIND_VOXELS * voxel_size_m as f32;
    // First how bright the images are, by some vertices.
    let some: Vec<u32> = (0..mesh.vertices.len() as u32)
        .step_by(mesh.vertices.len() / SAMPLES + 1)
        .collect();
    let mut brightness: Vec<Vec<(u32, f32)>> = Vec::with_capacity(usable.len());
    for &index in &usable {
        let (shot, photo) = open(log, index, mesh)?;
        let sample = |(number, &vertex): (usize, &u32)| {
            let (color, _) = shot.color(mesh, vertex as usize, &photo, behind_m)?;
            let is_clear = color.iter().all(|c| (DARK..BRIGHT).contains(c));
            is_clear.then(|| (number as u32, luminance(color)))
        };
        brightness.push(some.par_iter().enumerate().filter_map(sample).collect());
    }
    let gains = gains(&brightness, some.len());
    // Then all colours.
    let mut sums = vec![(Vec3::ZERO, 0.0_f32); mesh.vertices.len()];
    for (&index, &gain) in usable.iter().zip(&gains) {
        let (shot, photo) = open(log, index, mesh)?;
        sums.par_iter_mut().enumerate().for_each(|(vertex, sum)| {
            if let Some((color, weight)) = shot.color(mesh, vertex, &photo, behind_m) {
                let light = Vec3::from_array(color.map(linear)) * gain;
                *sum = (sum.0 + light * weight, sum.1 + weight);
            }
        });
    }
    spread(&mesh.triangles, &mut sums);
    let color = |(light, weight): &(Vec3, f32)| {
        if *weight > 0.0 {
            (*light / *weight).to_array().map(srgb)
        } else {
            UNSEEN
        }
    };
    Ok(Painted {
        seen: sums.iter().filter(|(_, weight)| *weight > 0.0).count(),
        colors: sums.iter().map(color).collect(),
        images: usable.len(),
        gains,
    })
}

/// Gives vertices without light the mean of those that they share a triangle with, some rounds long.
fn spread(triangles: &[[u32; 3]], sums: &mut [(Vec3, f32)]) {
    for _ in 0..SPREAD_EDGES {
        let is_dark = |vertex: u32| sums[vertex as usize].1 <= 0.0;
        let mut found: BTreeMap<u32, (Vec3, f32)> = BTreeMap::new();
        for corners in triangles {
            for vertex in corners.iter().copied().filter(|vertex| is_dark(*vertex)) {
                for beside in corners.iter().copied().filter(|beside| !is_dark(*beside)) {
                    let (light, weight) = sums[beside as usize];
                    let mean = found.entry(vertex).or_default();
                    *mean = (mean.0 + light / weight, mean.1 + 1.0);
                }
            }
        }
        for (vertex, mean) in found {
            sums[vertex as usize] = mean;
        }
    }
}

/// Reads an image, and finds out what hides what from its camera.
fn open<'a>(log: &'a Log, index: usize, mesh: &Mesh) -> Result<(Shot<'a>, Photo)> {
    let image = &log.images()[index];
    let photo = photo::decode(&image.name, &log.read_image(index)?)?;
    let Pinhole {
        width,
        height,
        fx,
        fy,
        cx,
        cy,
    } = image.camera;
    if (photo.width, photo.height) != (width as usize, height as usize) {
        let (name, w, h) = (&image.name, photo.width, photo.height);
        return Err(RunError::config(format_args!(
            "{name}: is an image of {w} x {h} pixels, and its camera has {width} x {height}"
        )));
    }
    let pose = image.pose.unwrap_or(Pose::IDENTITY);
    let scale = COARSER as f32;
    let coarse = Pinhole {
        width: width.div_ceil(COARSER),
        height: height.div_ceil(COARSER),
        fx: fx / scale,
        fy: fy / scale,
        cx: (cx + 0.5) / scale - 0.5,
        cy: (cy + 0.5) / scale - 0.5,
    };
    let camera_from_world = pose.inverse();
    let shot = Shot {
        image,
        eye: pose.translation,
        depths: Depths::of(mesh, &coarse, &camera_from_world),
        camera_from_world,
    };
    Ok((shot, photo))
}

impl Shot<'_> {
    /// The colour of a vertex, if the image sees it, and how much it counts.
    fn color(&self, mesh: &Mesh, vertex: usize, photo: &Photo, behind_m: f32) -> Option<([f32; 3], f32)> {
        let place = mesh.vertices[vertex];
        let back = (self.eye - place).as_vec3();
        let distance_m = back.length();
        let cos = mesh.normals[vertex].dot(back) / distance_m;
        if !(distance_m < FARTHEST_M && cos > LEAST_COS) {
            return None;
        }
        let seen = self.camera_from_world.transform_point(place).as_vec3();
        if seen.z < 0.1 {
            return None;
        }
        let camera = &self.image.camera;
        let (x, y) = (seen.x / seen.z, seen.y / seen.z);
        let (u, v) = (camera.fx * x + camera.cx, camera.fy * y + camera.cy);
        // What hides it is looked up where an undistorted camera would see it.
        let is_in = u > 0.0 && v > 0.0 && u < (camera.width - 1) as f32 && v < (camera.height - 1) as f32;
        if !is_in || self.is_hidden([u, v], seen.z, behind_m) {
            return None;
        }
        let (u, v) = match &self.image.distortion {
            Some(d) => {
                let [x, y] = distorted(d, [x, y]);
                (camera.fx * x + camera.cx, camera.fy * y + camera.cy)
            }
            None => (u, v),
        };
        let color = photo.at(u, v)?;
        // A pixel's footprint on the surface: the finest view counts most.
        let detail = cos / distance_m;
        Some((color, detail * detail * detail))
    }

    fn is_hidden(&self, [u, v]: [f32; 2], depth_m: f32, behind_m: f32) -> bool {
        let scale = COARSER as f32;
        let (column, row) = (((u + 0.5) / scale - 0.5).round(), ((v + 0.5) / scale - 0.5).round());
        let depths = &self.depths;
        let column = (column.max(0.0) as usize).min(depths.width - 1);
        let row = (row.max(0.0) as usize).min(depths.height - 1);
        // At the edge of something near, neighbouring pixels see it first: it hides a little more than it should.
        let around = (row.saturating_sub(1)..=row + 1)
            .flat_map(|row| (column.saturating_sub(1)..=column + 1).map(move |column| (column, row)));
        let first = around
            .map(|(column, row)| depths.at(column, row))
            .fold(f32::INFINITY, f32::min);
        // Grazing surface is much deeper within three pixels.
        depth_m > depths.between([u, v].map(|x| (x + 0.5) / scale - 0.5)) + behind_m
            || depth_m > first + 0.05 * depth_m + 4.0 * behind_m
    }
}

/// Along the optical axis, how far the first surface is that each pixel sees.
struct Depths {
    width: usize,
    height: usize,
    /// Row by row; infinite where a pixel sees none.
    metres: Vec<f32>,
}

/// Surface nearer than this to a camera hides nothing, metres.
const NEAREST_M: f32 = 0.1;

impl Depths {
    /// Triangle by triangle. The nearest one counts, in whatever order they come.
    fn of(mesh: &Mesh, camera: &Pinhole, camera_from_world: &Pose) -> Self {
        let (width, height) = (camera.width as usize, camera.height as usize);
        let corner = |vertex: &DVec3| {
            let seen = camera_from_world.transform_point(*vertex).as_vec3();
            let inverse = 1.0 / seen.z;
            let pixel = Vec3::new(
                camera.fx * seen.x * inverse + camera.cx,
                camera.fy * seen.y * inverse + camera.cy,
                inverse,
            );
            (NEAREST_M..2.0 * FARTHEST_M).contains(&seen.z).then_some(pixel)
        };
        let corners: Vec<Option<Vec3>> = mesh.vertices.par_iter().map(corner).collect();
        let each = mesh.triangles.len().div_ceil(rayon::current_num_threads()).max(1);
        let parts = mesh.triangles.par_chunks(each).map(|triangles| {
            let mut inverse = vec![0.0_f32; width * height];
            for triangle in triangles {
                if let [Some(a), Some(b), Some(c)] = triangle.map(|vertex| corners[vertex as usize]) {
                    fill(&mut inverse, [width, height], [a, b, c]);
                }
            }
            inverse
        });
        let nearest = parts.reduce(Vec::new, |mut a, b| {
            if a.is_empty() {
                return b;
            }
            a.iter_mut().zip(b).for_each(|(a, b)| *a = a.max(b));
            a
        });
        Self {
            width,
            height,
            metres: nearest.into_iter().map(f32::recip).collect(),
        }
    }

    /// Between the four pixels around a place: exact on planes, whose inverse depth is linear, however grazing they are.
    fn between(&self, [u, v]: [f32; 2]) -> f32 {
        let (column, row) = (u.max(0.0), v.max(0.0));
        let (s, t) = (column.fract(), row.fract());
        let (column, row) = (column as usize, row as usize);
        let inverse = |dx: usize, dy: usize| {
            let at = (column + dx).min(self.width - 1);
            self.at(at, (row + dy).min(self.height - 1)).recip()
        };
        let [top, bottom] = [0, 1].map(|dy| inverse(0, dy) + s * (inverse(1, dy) - inverse(0, dy)));
        (top + t * (bottom - top)).recip()
    }

    /// Beyond the picture, nothing is seen.
    fn at(&self, column: usize, row: usize) -> f32 {
        let place = Some(row * self.width + column).filter(|_| column < self.width);
        place
            .and_then(|at| self.metres.get(at))
            .copied()
            .unwrap_or(f32::INFINITY)
    }
}

/// Draws a triangle whose corners are column, row, and inverse depth, which is linear in both.
fn fill(nearest: &mut [f32], [width, height]: [usize; 2], [a, b, c]: [Vec3; 3]) {
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    // Conversions saturate.
    let columns = low.x.ceil().max(0.0) as usize..((high.x.floor() + 1.0).max(0.0) as usize).min(width);
    let rows = low.y.ceil().max(0.0) as usize..((high.y.floor() + 1.0).max(0.0) as usize).min(height);
    let (ab, ac) = (b - a, c - a);
    let area = ab.x * ac.y - ab.y * ac.x;
    if columns.is_empty() || rows.is_empty() || area == 0.0 {
        return;
    }
    for row in rows {
        for column in columns.clone() {
            let (x, y) = (column as f32 - a.x, row as f32 - a.y);
            let (s, t) = ((x * ac.y - y * ac.x) / area, (ab.x * y - ab.y * x) / area);
            // A little more than the triangle: no gaps between neighbours.
            if s >= -1e-4 && t >= -1e-4 && s + t <= 1.0 + 1e-4 {
                let pixel = &mut nearest[row * width + column];
                *pixel = pixel.max(a.z + s * ab.z + t * ac.z);
            }
        }
    }
}

/// OpenCV's k1, k2, p1, p2, k3 on normalised coordinates.
fn distorted(&[k1, k2, p1, p2, k3]: &[f64; 5], place: [f32; 2]) -> [f32; 2] {
    let [x, y] = place.map(f64::from);
    let r2 = x * x + y * y;
    let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
    let dx = 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x);
    let dy = p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y;
    [(x * radial + dx) as f32, (y * radial + dy) as f32]
}

fn luminance([r, g, b]: [f32; 3]) -> f32 {
    0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b)
}

/// Linear light, 0 to 1, of an sRGB value of 255 (IEC 61966-2-1).
pub(crate) fn linear(srgb: f32) -> f32 {
    let value = srgb / 255.0;
    if value <= 0.040_45 {
        value / 12.92
    } else {
        ((value + 0.055) / 1.055).powf(2.4)
    }
}

pub(crate) fn srgb(light: f32) -> u8 {
    let value = if light <= 0.003_130_8 {
        12.92 * light
    } else {
        1.055 * light.powf(1.0 / 2.4) - 0.055
    };
    (255.0 * value + 0.5) as u8
}

/// By how much each image is brightened, such that vertices are as bright in all that see them; 1 in the mean. Each image's list
/// has vertices and their luminance.
fn gains(brightness: &[Vec<(u32, f32)>], vertices: usize) -> Vec<f32> {
    let mut gains = vec![0.0_f64; brightness.len()]; // logarithms
    for _ in 0..ROUNDS {
        let mut means = vec![(0.0_f64, 0.0_f64); vertices];
        for (gain, seen) in gains.iter().zip(brightness) {
            for &(vertex, luminance) in seen {
                let mean = &mut means[vertex as usize];
                *mean = (mean.0 + f64::from(luminance).ln() + gain, mean.1 + 1.0);
            }
        }
        for (gain, seen) in gains.iter_mut().zip(brightness) {
            // The median, which glints and what moves do not shift.
            let shared = seen.iter().filter(|(vertex, _)| means[*vertex as usize].1 > 1.0);
            let mut off: Vec<f64> = shared
                .map(|&(vertex, luminance)| {
                    let (sum, count) = means[vertex as usize];
                    sum / count - f64::from(luminance).ln()
                })
                .collect();
            if !off.is_empty() {
                let half = off.len() / 2;
                *gain = *off.select_nth_unstable_by(half, f64::total_cmp).1;
            }
        }
        let mean = gains.iter().sum::<f64>() / gains.len().max(1) as f64;
        gains.iter_mut().for_each(|gain| *gain -= mean);
    }
    gains.iter().map(|gain| gain.exp().clamp(0.2, 5.0) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exposures_are_found_where_images_overlap() {
        // Four images along a row of vertices, each brighter than the one before.
        let light = |vertex: u32| 0.1 + 0.2 * (f64::from(vertex) * 0.37).sin().abs();
        let exposure = [1.0, 1.5, 2.0, 0.7];
        let image = |(i, exposure): (usize, &f64)| {
            let seen = (30 * i as u32)..(30 * i as u32 + 60);
            seen.map(|vertex| (vertex, (exposure * light(vertex)) as f32)).collect()
        };
        let brightness: Vec<Vec<(u32, f32)>> = exposure.iter().enumerate().map(image).collect();
        let found = gains(&brightness, 200);
        let products: Vec<f64> = found
            .iter()
            .zip(exposure)
            .map(|(gain, exposure)| f64::from(*gain) * exposure)
            .collect();
        for product in &products {
            assert!((product / products[0] - 1.0).abs() < 0.05, "{products:?}");
        }
        assert_eq!(gains(&[Vec::new()], 0), [1.0]);
    }

    /// A tilted floor with a box before it, against rays.
    #[test]
    fn the_first_surface_along_each_pixel_is_found() {
        let camera = Pinhole {
            width: 64,
            height: 48,
            fx: 50.0,
            fy: 50.0,
            cx: 31.5,
            cy: 23.5,
        };
        let floor = |u: f64, v: f64| DVec3::new(4.0 * u - 2.0, 2.0 * v - 1.0, 4.0 - 2.0 * v);
        let wall = |u: f64, v: f64| DVec3::new(u - 0.5, v - 0.5, 2.0);
        let mut mesh = Mesh::default();
        for place in [&floor as &dyn Fn(f64, f64) -> DVec3, &wall] {
            for i in 0..40 * 40 {
                let (u, v) = (f64::from(i % 40) / 40.0, f64::from(i / 40) / 40.0);
                let first = mesh.vertices.len() as u32;
                let step = 1.0 / 40.0;
                mesh.vertices
                    .extend([(u, v), (u + step, v), (u, v + step), (u + step, v + step)].map(|(u, v)| place(u, v)));
                mesh.triangles
                    .extend([[first, first + 1, first + 2], [first + 3, first + 2, first + 1]]);
            }
        }
        // The world is turned and moved; so is the camera.
        let world = Pose::new(tsdfuse::glam::DQuat::from_rotation_y(0.7), DVec3::new(50.0, -3.0, 9.0)).unwrap();
        mesh.vertices
            .iter_mut()
            .for_each(|vertex| *vertex = world.transform_point(*vertex));
        let depths = Depths::of(&mesh, &camera, &world.inverse());
        for (row, column) in (0..48).flat_map(|row| (0..64).map(move |column| (row, column))) {
            let (x, y) = ((column as f32 - 31.5) / 50.0, (row as f32 - 23.5) / 50.0);
            // z = 3 − y·z on the floor.
            let z = 3.0 / (1.0 + y);
            let is_inside = |x: f32, y: f32, by: [f32; 2]| x.abs() < by[0] && y.abs() < by[1];
            let is_edge = |x: f32, y: f32, by: [f32; 2]| {
                is_inside(x, y, by.map(|b| b + 0.05)) != is_inside(x, y, by.map(|b| b - 0.05))
            };
            if is_edge(2.0 * x, 2.0 * y, [0.5, 0.5]) || is_edge(z * x, z * y, [2.0, 1.0]) {
                continue;
            }
            let expected = if is_inside(2.0 * x, 2.0 * y, [0.5, 0.5]) {
                2.0
            } else if is_inside(z * x, z * y, [2.0, 1.0]) {
                z
            } else {
                f32::INFINITY
            };
            let found = depths.at(column, row);
            assert!(
                found == expected || (found - expected).abs() < 1e-3,
                "{column} {row}: {found} {expected}"
            );
        }
        assert_eq!((depths.at(64, 0), depths.at(0, 48)), (f32::INFINITY, f32::INFINITY));
    }

    /// A strip of triangles, of which both ends are seen.
    #[test]
    fn what_is_grazed_takes_the_colour_of_what_is_beside_it() {
        let triangles: Vec<[u32; 3]> = (0..10).map(|i| [i, i + 1, i + 2]).collect();
        let mut sums = vec![(Vec3::ZERO, 0.0); 12];
        sums[0] = (Vec3::X * 2.0, 2.0);
        sums[11] = (Vec3::Y * 3.0, 3.0);
        spread(&triangles, &mut sums);
        let colors: Vec<Vec3> = sums.iter().map(|(light, weight)| *light / weight.max(1.0)).collect();
        // Two vertices further in each round; in the last, both colours meet.
        assert_eq!(colors[..5], [Vec3::X; 5]);
        assert_eq!(colors[7..], [Vec3::Y; 5]);
        let mixed = |vertex: usize| sums[vertex].0 / sums[vertex].1;
        assert!(
            [5, 6].map(mixed).iter().all(|color| color.x > 0.2 && color.y > 0.2),
            "{sums:?}"
        );
        let mut far = vec![(Vec3::ZERO, 0.0); 12];
        far[0] = (Vec3::X, 1.0);
        spread(&triangles, &mut far);
        assert!(far[6].1 > 0.0 && far[7].1 == 0.0, "three rounds, not more");
        // What was seen stays as it was.
        assert_eq!((sums[0], sums[11]), ((Vec3::X * 2.0, 2.0), (Vec3::Y * 3.0, 3.0)));
    }

    #[test]
    fn light_and_srgb_are_inverse() {
        (0..=255_u8).for_each(|value| assert_eq!(srgb(linear(f32::from(value))), value));
    }

    #[test]
    fn lenses_distort_as_opencv_says() {
        // cv2.projectPoints of (0.3, -0.2, 1) with these coefficients and the identity as camera matrix.
        let [x, y] = distorted(&[-0.3, 0.1, 0.001, -0.002, 0.0], [0.3, -0.2]);
        let r2: f32 = 0.13;
        let radial = 1.0 - 0.3 * r2 + 0.1 * r2 * r2;
        let wanted = [
            0.3 * radial + 2.0 * 0.001 * 0.3 * -0.2 - 0.002 * (r2 + 2.0 * 0.09),
            -0.2 * radial + 0.001 * (r2 + 2.0 * 0.04) + 2.0 * -0.002 * 0.3 * -0.2,
        ];
        assert!((x - wanted[0]).abs() < 1e-6 && (y - wanted[1]).abs() < 1e-6);
    }
}
