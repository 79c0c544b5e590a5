//! What the meshes look like: one sheet of pictures per scene, the same views of each method.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use anyhow::Result;
use rayon::prelude::*;
use tsdfuse::Mesh;
use tsdfuse::glam::{DMat3, DVec3};
use tsdfuse::sensor::Pinhole;
use tsdfuse_sim::Scene;

/// Where a picture is taken from, and what is in its middle; metres, world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View {
    pub(crate) from: DVec3,
    pub(crate) to: DVec3,
}

const WIDTH: usize = 320;
const HEIGHT: usize = 200;
const FOV_RAD: f32 = 1.1;

/// Nearer than this to the camera nothing is drawn, metres.
const NEAR_M: f64 = 0.2;

/// Pictures in a row of the sheet.
const ACROSS: usize = 4;

/// Grey values, white among them.
const LEVELS: u8 = 16;

/// Grey values of one picture, row by row, 0 to [`LEVELS`] − 1.
type Picture = Vec<u8>;

/// The pictures of one scene.
#[derive(Debug)]
pub(crate) struct Sheet {
    views: Vec<View>,
    pictures: Vec<Picture>,
}

impl Sheet {
    /// A sheet that begins with the true surface.
    pub(crate) fn new(truth: &Scene, views: &[View]) -> Self {
        Self {
            views: views.to_vec(),
            pictures: views.iter().map(|view| view.of_truth(truth)).collect(),
        }
    }

    /// Adds all views of a mesh.
    pub(crate) fn add(&mut self, mesh: &Mesh) {
        self.pictures
            .par_extend(self.views.par_iter().map(|view| view.of_mesh(mesh)));
    }

    /// Writes the sheet, row by row.
    pub(crate) fn write(&self, path: &Path) -> Result<()> {
        let rows = self.pictures.len().div_ceil(ACROSS);
        let (width, height) = (ACROSS * WIDTH, rows * HEIGHT);
        let mut sheet = vec![LEVELS - 1; width * height];
        for (number, picture) in self.pictures.iter().enumerate() {
            let start = number / ACROSS * HEIGHT * width + number % ACROSS * WIDTH;
            for (row, line) in picture.chunks(WIDTH).enumerate() {
                sheet[start + row * width..][..WIDTH].copy_from_slice(line);
            }
        }
        let mut png = png::Encoder::new(BufWriter::new(File::create(path)?), width as u32, height as u32);
        png.set_color(png::ColorType::Grayscale);
        png.set_depth(png::BitDepth::Four);
        png.set_compression(png::Compression::High);
        let packed: Vec<u8> = sheet.chunks(2).map(|pixels| pixels[0] << 4 | pixels[1]).collect();
        let mut writer = png.write_header()?;
        writer.write_image_data(&packed)?;
        Ok(writer.finish()?)
    }
}

impl View {
    fn camera() -> Pinhole {
        Pinhole::with_fov(WIDTH as u32, HEIGHT as u32, FOV_RAD)
    }

    /// World from camera: x forward, y left, z up.
    fn axes(&self) -> DMat3 {
        let ahead = (self.to - self.from).normalize();
        let left = DVec3::Z.cross(ahead).normalize();
        DMat3::from_cols(ahead, left, ahead.cross(left))
    }

    fn of_truth(&self, scene: &Scene) -> Picture {
        let (camera, axes) = (Self::camera(), self.axes());
        let pixel = |i: usize| {
            let ray = axes
                * camera
                    .ray((i % WIDTH) as f32, (i / WIDTH) as f32)
                    .as_dvec3()
                    .normalize();
            scene
                .cast(self.from, ray)
                .map_or(LEVELS - 1, |hit| grey(-hit.normal.dot(ray)))
        };
        (0..WIDTH * HEIGHT).into_par_iter().map(pixel).collect()
    }

    /// Draws triangle by triangle, what is nearer over what is farther away.
    fn of_mesh(&self, mesh: &Mesh) -> Picture {
        let (camera, to_camera) = (Self::camera(), self.axes().transpose());
        let mut picture = vec![LEVELS - 1; WIDTH * HEIGHT];
        let mut nearness = vec![0.0; WIDTH * HEIGHT]; // 1 / depth
        for triangle in &mesh.triangles {
            let corners = triangle.map(|v| to_camera * (mesh.vertices[v as usize] - self.from));
            if corners.iter().any(|c| c.x < NEAR_M) {
                continue;
            }
            let [a, b, c] = corners.map(|c| {
                let (u, v) = camera.project(c.as_vec3());
                DVec3::new(f64::from(u), f64::from(v), 1.0 / c.x) // 1 / depth is linear in the image
            });
            let normal = (corners[1] - corners[0])
                .cross(corners[2] - corners[0])
                .normalize_or_zero();
            let shade = grey(-normal.dot(corners[0].normalize()));
            let twice_area = (b - a).truncate().perp_dot((c - a).truncate());
            let range = |axis: usize, size: usize| {
                let least = a[axis].min(b[axis]).min(c[axis]).ceil().max(0.0);
                let most = a[axis].max(b[axis]).max(c[axis]).floor().min(size as f64 - 1.0);
                // Empty where the triangle is outside of the image.
                least as usize..(most + 1.0).max(0.0) as usize
            };
            for (row, column) in range(1, HEIGHT).flat_map(|row| range(0, WIDTH).map(move |column| (row, column))) {
                let p = DVec3::new(column as f64, row as f64, 0.0);
                let share = |d: DVec3, e: DVec3| (d - p).truncate().perp_dot((e - p).truncate()) / twice_area;
                let shares = [share(b, c), share(c, a), share(a, b)];
                let near = shares[0] * a.z + shares[1] * b.z + shares[2] * c.z;
                let pixel = row * WIDTH + column;
                if shares.iter().all(|&s| s >= 0.0) && near > nearness[pixel] {
                    (nearness[pixel], picture[pixel]) = (near, shade);
                }
            }
        }
        picture
    }
}

/// Light comes from the camera; surface that is seen from behind is almost black.
fn grey(cos: f64) -> u8 {
    let light = if cos > 0.0 { 0.25 + 0.65 * cos } else { 0.05 };
    (light * f64::from(LEVELS - 1)).round() as u8
}
