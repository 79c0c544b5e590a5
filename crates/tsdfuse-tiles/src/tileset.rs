//! `tileset.json` of 3D Tiles 1.1 (OGC 22-025r4).

use serde::Serialize;
use tsdfuse::glam::DVec3;

use crate::bounds::Bounds;

/// The file.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Tileset {
    asset: Asset,
    geometric_error: f64,
    root: Node,
}

#[derive(Debug, Serialize)]
struct Asset {
    version: &'static str,
    generator: String,
}

/// A tile, and the children that replace it when the viewer comes closer.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Node {
    #[serde(skip_serializing_if = "Option::is_none")]
    transform: Option<[f64; 16]>,
    bounding_volume: BoundingVolume,
    /// Metres between this surface and the finest one.
    geometric_error: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    refine: Option<&'static str>,
    content: Content,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    children: Vec<Node>,
}

/// Its centre, and half its edges along x, y and z.
#[derive(Debug, Serialize)]
struct BoundingVolume {
    #[serde(rename = "box")]
    middle_and_halves: [f64; 12],
}

#[derive(Debug, Serialize)]
struct Content {
    uri: String,
}

impl Node {
    /// A tile whose mesh is in a file; bounds and error in metres.
    pub(crate) fn new(uri: String, bounds: &Bounds, error_m: f64, children: Vec<Self>) -> Self {
        Self {
            transform: None,
            bounding_volume: BoundingVolume::about(bounds),
            geometric_error: error_m,
            refine: None,
            content: Content { uri },
            children,
        }
    }

    /// The number of tiles in this subtree, and its depth.
    pub(crate) fn count(&self) -> (usize, usize) {
        let below = self.children.iter().map(Self::count);
        let (tiles, levels) = below.fold((0, 0), |all, one| (all.0 + one.0, all.1.max(one.1)));
        (tiles + 1, levels + 1)
    }
}

impl BoundingVolume {
    fn about(bounds: &Bounds) -> Self {
        let (middle, half) = (bounds.middle(), (bounds.max - bounds.min) / 2.0);
        let [x, y, z] = middle.to_array();
        Self {
            middle_and_halves: [x, y, z, half.x, 0.0, 0.0, 0.0, half.y, 0.0, 0.0, 0.0, half.z],
        }
    }
}

impl Tileset {
    /// The tileset of a tree of tiles whose origin is at `origin` in the world. `size_m` is the error of showing
    /// nothing at all.
    pub(crate) fn new(mut root: Node, origin: DVec3, size_m: f64) -> Self {
        let DVec3 { x, y, z } = origin;
        root.transform = Some([1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, x, y, z, 1.0]);
        root.refine = Some("REPLACE");
        Self {
            asset: Asset {
                version: "1.1",
                generator: format!("tsdfuse {}", env!("CARGO_PKG_VERSION")),
            },
            geometric_error: size_m,
            root,
        }
    }
}
