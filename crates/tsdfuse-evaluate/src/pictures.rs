//! Pictures of each mesh from the same places.

use std::f64::consts::FRAC_PI_4;

use rayon::prelude::*;
use tsdfuse::glam::DVec3;
use tsdfuse::render::Image;
use tsdfuse::sensor::Pinhole;
use tsdfuse::{Mesh, Pose};
use tsdfuse_eval::Reference;
use tsdfuse_eval::picture::{View, sheet};

use crate::colored;
use crate::error::Result;

/// Size of a picture.
const SIZE: (u32, u32) = (480, 300);
const FOV_RAD: f32 = 1.1;

/// The share of the vertices at each side of the box that a view from above need not show.
const BEYOND: f64 = 0.05;

/// Views in a row of the contact sheet.
const ACROSS: usize = 4;

/// Where pictures are taken from; the same for all meshes.
#[derive(Debug)]
pub(crate) struct Views {
    views: Vec<(String, View)>,
    max_error_m: f64,
}

/// Pictures of all meshes.
#[derive(Debug, Default)]
pub struct Gallery {
    /// What the views are called.
    pub views: Vec<String>,
    /// The pictures, method by method.
    pub shots: Vec<Shot>,
    /// The error at the bright end of the colours, metres.
    pub max_error_m: f64,
    /// Methods, and the pages beside the report that show their meshes in 3D.
    pub pages: Vec<(String, String)>,
    images: Vec<Image>,
    names: Vec<String>,
}

/// One view of one mesh.
#[derive(Debug)]
pub struct Shot {
    /// The method, or `reference`.
    pub name: String,
    /// The number of the view.
    pub view: usize,
    /// PNG.
    pub surface: Vec<u8>,
    /// In the colours of its errors, PNG; none of the reference.
    pub error: Option<Vec<u8>>,
}

impl Views {
    /// The views that were asked for, or from above and from the sensor, one and two thirds along its way.
    pub(crate) fn choose(asked: &[[DVec3; 2]], max_error_m: f64, poses: &[Pose], mesh: &Mesh) -> Self {
        let camera = Pinhole::with_fov(SIZE.0, SIZE.1, FOV_RAD);
        let asked = asked.iter().map(|&[from, to]| {
            let place = |p: DVec3| format!("({:.1}, {:.1}, {:.1})", p.x, p.y, p.z);
            (
                format!("From {} to {}", place(from), place(to)),
                View::between(camera, from, to),
            )
        });
        let mut views: Vec<_> = asked.collect();
        if views.is_empty() {
            views.extend(from_above(camera, mesh).map(|view| ("From above".to_owned(), view)));
            let thirds = [poses.len() / 3, 2 * poses.len() / 3];
            for (number, pose) in thirds.into_iter().filter_map(|i| Some((i, poses.get(i)?))) {
                // Level, but for looking a little down.
                let ahead = (pose.rotation * DVec3::X)
                    .with_z(0.0)
                    .try_normalize()
                    .unwrap_or(DVec3::X);
                let to = pose.translation + ahead - 0.15 * DVec3::Z;
                views.push((
                    format!("From the sensor in scan {number}"),
                    View::between(camera, pose.translation, to),
                ));
            }
        }
        Self { views, max_error_m }
    }
}

/// A view of nearly all of a mesh at an angle; surface that faces away is left out.
fn from_above(camera: Pinhole, mesh: &Mesh) -> Option<View> {
    let bounds = [0, 1, 2].map(|axis| {
        let mut along: Vec<f64> = mesh.vertices.iter().map(|v| v[axis]).collect();
        along.sort_by(f64::total_cmp);
        let rank = |share: f64| along.get((share * along.len() as f64) as usize).copied();
        Some([rank(BEYOND)?, rank(1.0 - BEYOND)?])
    });
    let [Some([x0, x1]), Some([y0, y1]), Some([z0, z1])] = bounds else {
        return None;
    };
    let middle = 0.5 * DVec3::new(x0 + x1, y0 + y1, z0 + z1);
    // Across the long side.
    let turn = if x1 - x0 > y1 - y0 {
        -1.4 * FRAC_PI_4
    } else {
        0.6 * FRAC_PI_4
    };
    let (sin, cos) = turn.sin_cos();
    let back = DVec3::new(cos, sin, 0.75).normalize();
    let distance = 0.55 * DVec3::new(x1 - x0, y1 - y0, z1 - z0).length() / (0.5 * f64::from(FOV_RAD)).tan();
    let view = View::between(camera, middle + back * distance, middle);
    Some(View { cull: true, ..view })
}

impl Gallery {
    pub(crate) fn new(views: &Views) -> Self {
        Self {
            views: views.views.iter().map(|(name, _)| name.clone()).collect(),
            max_error_m: views.max_error_m,
            ..Self::default()
        }
    }

    /// Adds what the reference looks like.
    pub(crate) fn add_reference(&mut self, views: &Views, reference: &Reference) -> Result<()> {
        let draw = |(_, view): &(String, View)| match (reference.as_mesh(), reference.points()) {
            (Some(mesh), _) => view.of_mesh(mesh, None),
            (None, points) => view.of_points(points.unwrap_or_default(), 1),
        };
        let images: Vec<Image> = views.views.par_iter().map(draw).collect();
        self.add("reference", images, None)
    }

    /// Adds all views of a mesh, and those in the colours of its errors.
    pub(crate) fn add_mesh(&mut self, views: &Views, name: &str, mesh: &Mesh, reference: &Reference) -> Result<()> {
        let colors = colored::by_distance(mesh, reference, views.max_error_m);
        let draw = |colors| -> Vec<Image> {
            let views = views.views.par_iter();
            views.map(|(_, view)| view.of_mesh(mesh, colors)).collect()
        };
        self.add(name, draw(None), Some(&draw(Some(&colors))))
    }

    fn add(&mut self, name: &str, surfaces: Vec<Image>, errors: Option<&[Image]>) -> Result<()> {
        for (view, surface) in surfaces.iter().enumerate() {
            let error = errors.and_then(|errors| errors.get(view));
            self.shots.push(Shot {
                name: name.to_owned(),
                view,
                surface: tsdfuse_io::png::encode(surface)?,
                error: error.map(tsdfuse_io::png::encode).transpose()?,
            });
        }
        self.images.extend(surfaces);
        self.names.push(name.to_owned());
        Ok(())
    }

    /// The surfaces, row by row, all views of one after another; and what they are.
    pub fn contact_sheet(&self) -> (Image, String) {
        let views = self.views.len().max(1);
        let across = views * (ACROSS / views).max(1);
        let names: Vec<_> = self.names.chunks(across / views).map(|row| row.join(", ")).collect();
        (sheet(&self.images.iter().collect::<Vec<_>>(), across), names.join("; "))
    }
}
