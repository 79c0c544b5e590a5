//! Comparing a mesh with a reference.

use tsdfuse::Mesh;
use tsdfuse::glam::DVec3;

use crate::bounds::Bounds;
use crate::dense::Density;
use crate::error::{EvalError, Result};
use crate::plausible;
use crate::protocol::{Protocol, Sampling, ToMesh};
use crate::reference::{CloudTree, Reference, TriangleTree, sound};
use crate::sample;

pub use crate::figures::{AtThreshold, Comparison, Dense, Direction, Inputs, Measures};
use crate::voxels::down_sample;

/// Compares a mesh with a reference.
///
/// # Errors
/// [`EvalError`] if the protocol is invalid, or if nothing of the mesh or of the reference can be measured.
pub fn compare(mesh: &Mesh, reference: &Reference, protocol: &Protocol) -> Result<Comparison> {
    protocol.check()?;
    let (mesh, broken) = sound("mesh", mesh.clone())?;
    let parts = Parts::new(&mesh, reference, protocol)?;
    let samples = parts.samples()?;
    let points = parts.reference_points()?;
    let inputs = Inputs {
        triangles: mesh.triangles.len(),
        area_m2: sample::area_m2(&mesh),
        mesh_bounds: parts.mesh_bounds,
        reference: reference.kind(),
        reference_points: points.len(),
        reference_bounds: reference.bounds(),
    };
    // A mesh is dense everywhere. A cloud is judged by its points before down-sampling.
    let density = (reference.kind() == "cloud").then(|| Density::of(&points, protocol.dense));
    let (samples, points, to_reference) = match protocol.voxel_m {
        None => {
            let to_reference = reference.distances(&samples);
            (samples, points, to_reference)
        }
        Some(voxel_m) => {
            let [samples, points] = [samples, points].map(|points| down_sample(&points, voxel_m));
            let to_reference = CloudTree::new(&points).distances(&samples);
            (samples, points, to_reference)
        }
    };
    let to_mesh = match protocol.to_mesh {
        ToMesh::Surface => TriangleTree::new(&mesh).distances(&points),
        ToMesh::Samples => CloudTree::new(&samples).distances(&points),
    };
    let all = Measures::of(&to_reference, &to_mesh, protocol)?;
    let mut warnings = plausible::warnings(&inputs, &all, protocol);
    warnings.extend(counted(broken, "triangles of the mesh"));
    warnings.extend(counted(
        reference.left_out(),
        &format!("parts of the reference {}", reference.kind()),
    ));
    let dense = density.as_ref().and_then(|density| {
        let [samples, points] = [(&samples, &to_reference), (&points, &to_mesh)];
        dense(density, samples, points, protocol)
    });
    if density.is_some() && dense.is_none() {
        let rule = protocol.dense;
        warnings.push(format!(
            "no part of both is densely observed: nowhere there do 3 × 3 × 3 cubes of {} m hold {} reference points",
            rule.cube_m, rule.points
        ));
    }
    Ok(Comparison {
        protocol: protocol.clone(),
        inputs,
        all,
        dense,
        warnings,
    })
}

/// A warning about invalid parts, if there are any.
fn counted(count: usize, what: &str) -> Option<String> {
    (count > 0).then(|| format!("{count} {what} are not finite or absurdly far away; they are left out"))
}

/// The inputs of a comparison, and the boxes that limit them.
struct Parts<'a> {
    mesh: &'a Mesh,
    mesh_bounds: Bounds,
    reference: &'a Reference,
    protocol: &'a Protocol,
    crop: Option<Bounds>,
}

impl<'a> Parts<'a> {
    fn new(mesh: &'a Mesh, reference: &'a Reference, protocol: &'a Protocol) -> Result<Self> {
        let used: Vec<DVec3> = mesh
            .triangles
            .iter()
            .flatten()
            .map(|&v| mesh.vertices[v as usize])
            .collect();
        Ok(Self {
            mesh,
            mesh_bounds: Bounds::of(&used).ok_or(EvalError::NoTriangles("mesh"))?,
            reference,
            protocol,
            crop: protocol.crop.map(|[min, max]| Bounds { min, max }),
        })
    }

    /// Points sampled on the mesh.
    fn samples(&self) -> Result<Vec<DVec3>> {
        let mut mesh = None;
        let mut restrict = |keep: &dyn Fn([DVec3; 3]) -> bool, within: String| {
            let part = mesh.get_or_insert_with(|| self.mesh.clone());
            let vertices = &part.vertices;
            part.triangles.retain(|t| keep(t.map(|v| vertices[v as usize])));
            if sample::area_m2(part) > 0.0 {
                Ok(())
            } else {
                Err(EvalError::NothingWithin { of: "mesh", within })
            }
        };
        if self.protocol.within_reference_box {
            let mut bounds = self.reference.bounds();
            // As in the papers' scripts: upwards and downwards only.
            let margin = DVec3::Z * self.protocol.voxel_m.unwrap_or(0.0);
            bounds.min -= margin;
            bounds.max += margin;
            let keep = |t: [DVec3; 3]| t.iter().all(|&corner| bounds.contains(corner));
            restrict(&keep, format!("the reference's box, {} to {}", bounds.min, bounds.max))?;
        }
        if let Some(crop) = &self.crop {
            let touches = |t: [DVec3; 3]| Bounds::of(&t).is_some_and(|bounds| bounds.gap_m(crop) == 0.0);
            restrict(&touches, within(crop))?;
        }
        let samples = take_samples(mesh.as_ref().unwrap_or(self.mesh), self.protocol);
        self.cropped("mesh", samples)
    }

    /// The points of the reference that the mesh should come close to.
    fn reference_points(&self) -> Result<Vec<DVec3>> {
        let points = match (self.reference.points(), self.reference.as_mesh()) {
            (None, Some(mesh)) => take_samples(mesh, self.protocol),
            (points, _) => points.unwrap_or_default().to_vec(),
        };
        self.cropped("reference", points)
    }

    fn cropped(&self, of: &'static str, mut points: Vec<DVec3>) -> Result<Vec<DVec3>> {
        if let Some(crop) = &self.crop {
            points.retain(|&p| crop.contains(p));
            if points.is_empty() {
                let within = within(crop);
                return Err(EvalError::NothingWithin { of, within });
            }
        }
        Ok(points)
    }
}

fn within(crop: &Bounds) -> String {
    format!("the crop, {} to {}", crop.min, crop.max)
}

fn take_samples(mesh: &Mesh, protocol: &Protocol) -> Vec<DVec3> {
    match protocol.sampling {
        Sampling::Uniform => sample::uniform(mesh, protocol.samples),
        Sampling::PoissonDisk => sample::poisson_disk(mesh, protocol.samples),
    }
}

/// The figures of the densely observed places, if there are any, from all places and their distances.
fn dense(
    density: &Density,
    samples: (&Vec<DVec3>, &Vec<f64>),
    points: (&Vec<DVec3>, &Vec<f64>),
    protocol: &Protocol,
) -> Option<Dense> {
    let [there, back] = [samples, points].map(|(places, distances)| -> Vec<f64> {
        let dense = density.dense(places);
        distances
            .iter()
            .zip(dense)
            .filter_map(|(&d, dense)| dense.then_some(d))
            .collect()
    });
    Some(Dense {
        share_of_mesh: there.len() as f64 / samples.0.len() as f64,
        share_of_reference: back.len() as f64 / points.0.len() as f64,
        measures: Measures::of(&there, &back, protocol).ok()?,
    })
}

#[cfg(test)]
mod tests;
