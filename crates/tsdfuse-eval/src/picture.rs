//! Pictures of a mesh, drawn triangle by triangle. Triangles that face away are almost black; a view of the map
//! ([`tsdfuse::render`]) does not show them.

mod sheet;

use tsdfuse::glam::{DMat3, DQuat, DVec3};
use tsdfuse::render::{Image, Pixels};
use tsdfuse::sensor::Pinhole;
use tsdfuse::{Mesh, Pose};

use sheet::BACKGROUND;
pub use sheet::sheet;

/// Nothing is drawn nearer than this to the camera, metres.
const NEAR_M: f64 = 0.2;

/// Steps of brightness: pictures with few colours make small files.
const LEVELS: f64 = 16.0;

/// The colour of a surface without colours.
const GREY: [u8; 3] = [230; 3];

/// The viewpoint of a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// The camera.
    pub camera: Pinhole,
    /// `world_from_camera`: x forward, y left, z up.
    pub pose: Pose,
    /// Whether triangles that face away are left out instead of drawn almost black, to look into a room from outside.
    pub cull: bool,
}

impl View {
    /// A view from one place towards another, upright; metres, world.
    pub fn between(camera: Pinhole, from: DVec3, to: DVec3) -> Self {
        let ahead = (to - from).try_normalize().unwrap_or(DVec3::X);
        // When looking straight up or down, the world's y axis points left.
        let left = DVec3::Z.cross(ahead).try_normalize().unwrap_or(DVec3::Y);
        let rotation = DQuat::from_mat3(&DMat3::from_cols(ahead, left, ahead.cross(left)));
        let pose = Pose {
            rotation,
            translation: from,
        };
        Self {
            camera,
            pose,
            cull: false,
        }
    }

    /// Draws a mesh, in the colours of its vertices (red, green, blue) if given.
    pub fn of_mesh(&self, mesh: &Mesh, colors: Option<&[[u8; 3]]>) -> Image {
        let mut canvas = Canvas::new(self);
        for triangle in &mesh.triangles {
            let corners = triangle.map(|v| canvas.to_camera(mesh.vertices[v as usize]));
            let color = match colors {
                Some(colors) => mean(triangle.map(|v| colors[v as usize])),
                None => GREY,
            };
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
            let cos = -normal.normalize_or_zero().dot(corners[0].normalize_or_zero());
            if cos > 0.0 || !self.cull {
                // Colours carry meaning, so they keep most of their brightness.
                let light = if colors.is_some() && cos > 0.0 {
                    0.5 + 0.5 * light(cos)
                } else {
                    light(cos)
                };
                let shaded = color.map(|c| (f64::from(c) * light) as u8);
                clipped(corners, |triangle| canvas.draw(triangle, shaded));
            }
        }
        canvas.into_image()
    }

    /// Draws points, each as a square of `size` pixels.
    pub fn of_points(&self, points: &[DVec3], size: usize) -> Image {
        let mut canvas = Canvas::new(self);
        for &point in points {
            let p = canvas.to_camera(point);
            if p.x >= NEAR_M {
                canvas.dot(p, size);
            }
        }
        canvas.into_image()
    }
}

/// Light comes from the camera; a surface seen from behind is almost black.
fn light(cos: f64) -> f64 {
    let light = if cos > 0.0 { 0.3 + 0.7 * cos } else { 0.06 };
    (light * LEVELS).round() / LEVELS
}

fn mean(colors: [[u8; 3]; 3]) -> [u8; 3] {
    // In steps of 8, for small files.
    std::array::from_fn(|i| (colors.iter().map(|c| u16::from(c[i])).sum::<u16>() / 3) as u8 & !7)
}

/// The part of a triangle that is far enough ahead of the camera, as triangles.
fn clipped(corners: [DVec3; 3], mut draw: impl FnMut([DVec3; 3])) {
    let mut kept = [DVec3::ZERO; 4];
    let mut count = 0;
    let mut keep = |p| {
        kept[count] = p;
        count += 1;
    };
    for (a, b) in [(0, 1), (1, 2), (2, 0)].map(|(a, b)| (corners[a], corners[b])) {
        if a.x >= NEAR_M {
            keep(a);
        }
        if (a.x >= NEAR_M) != (b.x >= NEAR_M) {
            keep(a.lerp(b, (NEAR_M - a.x) / (b.x - a.x)));
        }
    }
    for pair in kept[..count].windows(2).skip(1) {
        draw([kept[0], pair[0], pair[1]]);
    }
}

/// A picture while it is drawn.
struct Canvas {
    camera: Pinhole,
    camera_from_world: (DMat3, DVec3),
    pixels: Vec<[u8; 3]>,
    /// 1 / depth.
    nearness: Vec<f64>,
}

impl Canvas {
    fn new(view: &View) -> Self {
        let pixels = view.camera.width as usize * view.camera.height as usize;
        Self {
            camera: view.camera,
            camera_from_world: (DMat3::from_quat(view.pose.rotation).transpose(), view.pose.translation),
            pixels: vec![BACKGROUND; pixels],
            nearness: vec![0.0; pixels],
        }
    }

    fn to_camera(&self, point_in_world: DVec3) -> DVec3 {
        self.camera_from_world.0 * (point_in_world - self.camera_from_world.1)
    }

    /// Column, row and 1 / depth, which is linear in the image.
    fn project(&self, p: DVec3) -> DVec3 {
        let c = &self.camera;
        let [fx, fy, cx, cy] = [c.fx, c.fy, c.cx, c.cy].map(f64::from);
        DVec3::new(cx - fx * p.y / p.x, cy - fy * p.z / p.x, 1.0 / p.x)
    }

    /// The columns (axis 0) or rows between two places in the image; empty outside the image.
    fn between(&self, axis: usize, low: f64, high: f64) -> std::ops::Range<usize> {
        let size = [self.camera.width, self.camera.height][axis];
        let most = high.floor().min(f64::from(size) - 1.0);
        low.ceil().max(0.0) as usize..(most + 1.0).max(0.0) as usize
    }

    fn draw(&mut self, corners: [DVec3; 3], color: [u8; 3]) {
        let [a, b, c] = corners.map(|corner| self.project(corner));
        let twice_area = (b - a).truncate().perp_dot((c - a).truncate());
        let range = |axis| {
            self.between(
                axis,
                a[axis].min(b[axis]).min(c[axis]),
                a[axis].max(b[axis]).max(c[axis]),
            )
        };
        let (rows, columns) = (range(1), range(0));
        for (row, column) in rows.flat_map(|row| columns.clone().map(move |column| (row, column))) {
            let p = DVec3::new(column as f64, row as f64, 0.0);
            let share = |d: DVec3, e: DVec3| (d - p).truncate().perp_dot((e - p).truncate()) / twice_area;
            let shares = [share(b, c), share(c, a), share(a, b)];
            let near = shares[0] * a.z + shares[1] * b.z + shares[2] * c.z;
            if shares.iter().all(|&s| s >= 0.0) {
                self.set(row, column, near, color);
            }
        }
    }

    fn dot(&mut self, point: DVec3, size: usize) {
        let at = self.project(point);
        let half = 0.5 * size as f64;
        let (rows, columns) = (
            self.between(1, at.y - half, at.y + half),
            self.between(0, at.x - half, at.x + half),
        );
        // Far points are brighter, which shows depth.
        let shade = (60.0 + 120.0 * (point.x / 40.0).min(1.0)) as u8 & !7;
        for (row, column) in rows.flat_map(|row| columns.clone().map(move |column| (row, column))) {
            self.set(row, column, at.z, [shade; 3]);
        }
    }

    /// Sets a pixel unless something nearer was drawn there.
    fn set(&mut self, row: usize, column: usize, nearness: f64, color: [u8; 3]) {
        let pixel = row * self.camera.width as usize + column;
        if nearness > self.nearness[pixel] {
            (self.nearness[pixel], self.pixels[pixel]) = (nearness, color);
        }
    }

    fn into_image(self) -> Image {
        Image {
            width: self.camera.width as usize,
            height: self.camera.height as usize,
            pixels: Pixels::Rgb(self.pixels),
        }
    }
}

#[cfg(test)]
mod tests;
