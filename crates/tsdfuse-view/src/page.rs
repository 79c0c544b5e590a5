//! One HTML file that holds the viewer and a surface, and needs no network.

use std::borrow::Cow;
use std::io::{self, Write};
use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use rayon::prelude::*;
use serde::Serialize;
use tsdfuse::glam::DVec3;
use tsdfuse_io::Result;

use crate::chunks::{Lattice, bounds, pieces};
use crate::cluster::clustered;
use crate::scene::{Channel, Scene, Surface};

const PAGE: &str = include_str!("../page/index.html");
const STYLE: &str = include_str!("../page/style.css");
const VIEWER: &str = include_str!("../page/viewer.js");
const THREE: &str = include_str!("../page/three.min.js");

/// Triangles that a page has at most: more of them make browsers slow.
pub const MOST_TRIANGLES: usize = 5_000_000;

/// The shares of the vertices between whose heights colours are spread: what is farther up or down is rare.
const HEIGHTS: [f64; 2] = [0.02, 0.98];

/// What a page holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// Triangles: those of the surface, or fewer of a simplified one.
    pub triangles: usize,
    /// Size of the file.
    pub bytes: u64,
}

/// Whether a path asks for a page: `.html`.
pub fn is_page(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("html"))
}

/// What the viewer receives beside the pieces; places are relative to `origin`, metres.
#[derive(Debug, Serialize)]
struct Told<'a> {
    title: &'a str,
    /// World.
    origin: [f64; 3],
    /// Steps of the pieces' coordinates.
    step: f64,
    low: [f64; 3],
    high: [f64; 3],
    /// Heights of the first and the last colour.
    heights: [f64; 2],
    path: Vec<f64>,
    figures: Cow<'a, [(String, String)]>,
    colored: bool,
    channels: Vec<&'a Channel>,
}

/// Writes a page; the file appears when it is complete. A surface of more than [`MOST_TRIANGLES`] is simplified.
///
/// # Errors
/// Names the file and what the system says.
pub fn write(path: &Path, scene: &Scene, surface: &Surface<'_>) -> Result<Written> {
    let original = surface.mesh.triangles.len();
    let triangles = if original > MOST_TRIANGLES {
        let [low, _] = bounds(surface.mesh);
        let few = clustered(surface, low, MOST_TRIANGLES);
        few.with(|surface| write_all(path, scene, surface, Some(original)))?
    } else {
        write_all(path, scene, surface, None)?
    };
    Ok(Written {
        triangles,
        bytes: std::fs::metadata(path).map_or(0, |file| file.len()),
    })
}

fn write_all(path: &Path, scene: &Scene, surface: &Surface<'_>, original: Option<usize>) -> Result<usize> {
    let triangles = surface.mesh.triangles.len();
    let lattice = Lattice::of(surface.mesh);
    let [low, high] = bounds(surface.mesh).map(|corner| corner - lattice.origin);
    let mut figures = Cow::Borrowed(&*scene.figures);
    if let Some(original) = original {
        figures
            .to_mut()
            .push(("triangles shown".to_owned(), format!("{triangles} of {original}")));
    }
    let told = Told {
        title: &scene.title,
        origin: lattice.origin.to_array(),
        step: lattice.step_m,
        low: low.to_array(),
        high: high.to_array(),
        heights: heights(surface, lattice.origin),
        path: relative(&scene.path, lattice.origin),
        figures,
        colored: !surface.paint.colors.is_empty(),
        channels: surface.paint.channels.iter().map(|(channel, _)| channel).collect(),
    };
    let packed = pieces(surface, &lattice).into_par_iter().map(|piece| {
        let mut bytes = Vec::new();
        piece.pack(&mut bytes);
        deflated(&bytes)
    });
    let packed: Vec<Vec<u8>> = packed.collect::<io::Result<_>>().map_err(tsdfuse_io::Error::io(path))?;
    tsdfuse_io::atomic::write(path, |out| {
        fill(PAGE, out, |name, out| match name {
            "scene" => out.write_all(in_script(&serde_json::to_string(&told)?).as_bytes()),
            "pieces" => packed
                .iter()
                .try_for_each(|piece| writeln!(out, "<script>tsdfuse.piece(\"{}\")</script>", BASE64.encode(piece))),
            name => asset(name, out),
        })
    })?;
    Ok(triangles)
}

/// The page of a live view, which receives all but its title later; or of tiles.
#[cfg(feature = "live")]
pub(crate) fn live(title: &str, tiles: Option<&str>) -> io::Result<Vec<u8>> {
    let scene = serde_json::json!({
        "title": title, "live": true, "tiles": tiles, "origin": [0, 0, 0], "step": 1e-3, "heights": [0, 1], "colored": false, "channels": [],
    });
    let mut out = Vec::new();
    fill(PAGE, &mut out, |name, out| match name {
        "scene" => out.write_all(in_script(&scene.to_string()).as_bytes()),
        name => asset(name, out),
    })?;
    Ok(out)
}

/// The parts that are the same in all pages.
fn asset(name: &str, out: &mut impl Write) -> io::Result<()> {
    match name {
        "style" => out.write_all(STYLE.as_bytes()),
        "three" => out.write_all(BASE64.encode(deflated(THREE.as_bytes())?).as_bytes()),
        "viewer" => out.write_all(VIEWER.as_bytes()),
        _ => Ok(()),
    }
}

/// Writes a template, with what is wanted for each `{{name}}`.
fn fill<W: Write>(template: &str, out: &mut W, mut put: impl FnMut(&str, &mut W) -> io::Result<()>) -> io::Result<()> {
    let mut rest = template;
    while let Some((before, after)) = rest.split_once("{{") {
        out.write_all(before.as_bytes())?;
        let (name, after) = after.split_once("}}").unwrap_or((after, ""));
        put(name, out)?;
        rest = after;
    }
    out.write_all(rest.as_bytes())
}

/// JSON that cannot end the script element that it is in.
fn in_script(json: &str) -> String {
    json.replace('<', "\\u003c")
}

fn deflated(bytes: &[u8]) -> io::Result<Vec<u8>> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::new(7));
    encoder.write_all(bytes)?;
    encoder.finish()
}

/// Places relative to the origin, in whole millimetres, one number after the other.
fn relative(places: &[DVec3], origin: DVec3) -> Vec<f64> {
    let millimetres = |place: &DVec3| ((*place - origin) * 1e3).round() / 1e3;
    places.iter().flat_map(|place| millimetres(place).to_array()).collect()
}

/// Between which heights most of a surface lies, relative to the origin.
pub(crate) fn heights(surface: &Surface<'_>, origin: DVec3) -> [f64; 2] {
    let vertices = &surface.mesh.vertices;
    let mut heights: Vec<f64> = vertices
        .iter()
        .step_by(vertices.len() / 100_000 + 1)
        .map(|v| v.z - origin.z)
        .collect();
    if heights.is_empty() {
        return [0.0, 1.0];
    }
    heights.sort_unstable_by(f64::total_cmp);
    let [low, high] = HEIGHTS.map(|share| heights[(share * (heights.len() - 1) as f64) as usize]);
    [low, high.max(low + 1e-3)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use tsdfuse::Mesh;
    use tsdfuse::glam::Vec3;

    fn triangle() -> Mesh {
        Mesh {
            vertices: vec![DVec3::ZERO, DVec3::X, DVec3::Y],
            normals: vec![Vec3::Z; 3],
            triangles: vec![[0, 1, 2]],
        }
    }

    #[test]
    fn a_page_is_whole_in_itself_and_its_title_is_only_text() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.html");
        let scene = Scene {
            title: "</script><script>alert(1)</script>".to_owned(),
            path: vec![DVec3::new(1.0, 2.0, 3.0)],
            figures: vec![("scans".to_owned(), "1".to_owned())],
        };
        let written = write(&path, &scene, &Surface::of(&triangle())).unwrap();
        let page = std::fs::read_to_string(&path).unwrap();
        assert_eq!((written.triangles, written.bytes), (1, page.len() as u64));
        assert!(!page.contains("alert(1)</script>") && !page.contains("{{"));
        assert_eq!(page.matches("tsdfuse.piece(\"").count(), 1);
        // Nothing is fetched from anywhere.
        for source in ["src=", "href=\"http", "@import", "url(", "fetch("] {
            assert!(!page.contains(source), "{source}");
        }
        assert!(page.len() < 300_000, "{}", page.len());
    }

    #[test]
    fn heights_leave_out_what_is_rare() {
        let mut mesh = triangle();
        mesh.vertices = (0..1000).map(|i| DVec3::Z * f64::from(i)).collect();
        let [low, high] = heights(&Surface::of(&mesh), DVec3::Z * 100.0);
        assert!((low + 81.0).abs() < 2.0 && (high - 879.0).abs() < 2.0, "{low} {high}");
    }
}
