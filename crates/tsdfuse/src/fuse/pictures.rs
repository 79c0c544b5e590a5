//! Pictures of what methods make of a scan before they fuse it (thesis, Fig. 3.4, 3.5, 4.1, 4.2, 5.6 and 7.7).
//!
//! ```
//! use tsdfuse::{Scan, fuse::{FuseConfig, pictures::Picture}, glam::Vec3, sensor::model};
//! # let sensor = model("vlp16").ok_or("no such sensor")?;
//! # let ray = |ring: usize| Vec3::new(1.0, 0.0, sensor.elevations_deg[ring].to_radians().tan());
//! # let scan = Scan {
//! #     points: (0..16).map(|ring| 5.0 * ray(ring)).collect(),
//! #     rings: Some((0..16).collect()),
//! #     pose: Some(tsdfuse::Pose::IDENTITY),
//! #     ..Default::default()
//! # };
//!
//! let image = Picture::Filled.of(&scan, &FuseConfig::default(), Some(&sensor))?;
//! assert_eq!(image.width, 1800); // pixels; `tsdfuse_io::png` writes them
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! All pictures are panoramas from the pose of the scan, the highest row on top, with columns clockwise. Column 0 looks along the
//! sensor's x axis, in [`interpolated`] the middle of the first camera. Pixels without data are black.

use glam::{Mat3, Vec3};

use super::{
    Beams, Caminal, CaminalConfig, FuseConfig, FuseError, Kuehner, KuehnerConfig, depth::world_axes, placed::Placed,
    rings_of,
};
use crate::{
    index::Grid,
    normals::{NormalsConfig, estimate},
    render::{Image, Pixels, normal_color, viridis},
    scan::Scan,
    sensor::{CylindricalProjection, ScanImage, SensorModel},
    surfel::{Surfel, SurfelConfig, SurfelMap},
};

/// The depths at the dark and at the bright end of the colour map "viridis", metres; between them, colours are logarithmic.
pub const DEPTH_RANGE_M: [f32; 2] = [1.0, 100.0];

/// How far the picture of surfels extends beyond the outermost beams, as a tangent.
const MARGIN: f32 = 0.1;

/// The pictures by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Picture {
    /// [`normals`].
    Normals,
    /// [`surfels`].
    Surfels,
    /// [`cylindrical`].
    Cylindrical,
    /// [`filled`].
    Filled,
    /// [`interpolated`].
    Interpolated,
}

impl Picture {
    /// All pictures.
    pub const ALL: [Self; 5] = [
        Self::Normals,
        Self::Surfels,
        Self::Cylindrical,
        Self::Filled,
        Self::Interpolated,
    ];

    /// The name in lower case.
    pub fn name(self) -> &'static str {
        match self {
            Self::Normals => "normals",
            Self::Surfels => "surfels",
            Self::Cylindrical => "cylindrical",
            Self::Filled => "filled",
            Self::Interpolated => "interpolated",
        }
    }

    /// The picture of a scan, with the options of its method. Without a sensor's model, the scan decides which one it is.
    ///
    /// # Errors
    /// [`FuseError`], as from the method.
    pub fn of(self, scan: &Scan, config: &FuseConfig, sensor: Option<&SensorModel>) -> Result<Image, FuseError> {
        config.validate()?;
        match self {
            Self::Normals => normals(scan, &config.normals, sensor),
            Self::Surfels => surfels(scan, &config.surfel, sensor),
            Self::Cylindrical => cylindrical(scan, sensor),
            Self::Filled => filled(scan, config.kuehner, sensor),
            Self::Interpolated => interpolated(scan, config.caminal, sensor),
        }
    }
}

/// The normals of [`super::Normals`] in the organized image (Fig. 5.6): a row for each beam, a column for each firing. Red, green
/// and blue are ½ + ½·(x, y, z) in world axes; returns without a normal are black.
///
/// # Errors
/// [`FuseError`], as from the method.
pub fn normals(scan: &Scan, config: &NormalsConfig, sensor: Option<&SensorModel>) -> Result<Image, FuseError> {
    let placed = place(scan)?;
    let mut beams = Beams::new(sensor.cloned());
    let sensor = beams.of(scan)?;
    let mut image = ScanImage::new();
    image.update(&scan.points, &rings_of(scan, sensor), sensor);
    let mut normals = Vec::new();
    estimate(&image, &placed.points, origins(&placed), config, &mut normals);
    let top = image.rings() - 1;
    Ok(draw(image.columns(), image.rings(), |row, column| {
        let normal = normals[image.get(top - row, column)?];
        normal.is_some().then(|| normal_color(normal.normal))
    }))
}

/// The surfels of [`super::Surfels`] as discs (Fig. 3.4, 3.5 and 7.7), seen from the sensor. Their colour is their normal's, as in
/// [`normals`]: ground that faces down shows at once, as do discs that extend beyond edges.
///
/// # Errors
/// [`FuseError`] if the scan contradicts itself, or if no image can be made because it holds no valid returns.
pub fn surfels(scan: &Scan, config: &SurfelConfig, sensor: Option<&SensorModel>) -> Result<Image, FuseError> {
    let placed = place(scan)?;
    let mut beams = Beams::new(sensor.cloned());
    let sensor = beams.or_grid(scan)?.sensor;
    let world_from_sensor = world_axes(scan)?;
    let mut map = SurfelMap::default();
    map.update(&placed.points, origins(&placed), world_from_sensor.z_axis, config);
    let panorama = CylindricalProjection::new(&sensor, 0.0, 0.0, MARGIN);
    let mut nearest = vec![(f32::INFINITY, [0; 3]); panorama.rows() * panorama.columns()];
    for surfel in map.surfels() {
        splat(surfel, &panorama, world_from_sensor, &mut nearest);
    }
    Ok(draw(panorama.columns(), panorama.rows(), |row, column| {
        Some(nearest[row * panorama.columns() + column].1)
    }))
}

/// The cylindrical image of [`Kuehner`] with its measured pixels only (Fig. 4.2a). Colours are depths ([`DEPTH_RANGE_M`]).
///
/// # Errors
/// [`FuseError`], as from the method.
pub fn cylindrical(scan: &Scan, sensor: Option<&SensorModel>) -> Result<Image, FuseError> {
    filled(scan, KuehnerConfig { max_gap_deg: 0.0 }, sensor)
}

/// The cylindrical image of [`Kuehner`], filled (Fig. 4.2b). Colours are depths ([`DEPTH_RANGE_M`]).
///
/// # Errors
/// [`FuseError`], as from the method.
pub fn filled(scan: &Scan, config: KuehnerConfig, sensor: Option<&SensorModel>) -> Result<Image, FuseError> {
    let (_, mut image) = Kuehner::new(config, sensor.cloned()).project(grid(), scan)?;
    image.fill();
    let (columns, rows) = (image.projection.columns(), image.projection.rows());
    Ok(draw(columns, rows, |row, column| {
        depth_color(image.depth_m(row, column))
    }))
}

/// The interpolated images of [`Caminal`]'s virtual cameras (Fig. 4.1), side by side. Colours are depths ([`DEPTH_RANGE_M`]) along
/// the optical axis of each camera.
///
/// # Errors
/// [`FuseError`], as from the method.
pub fn interpolated(scan: &Scan, config: CaminalConfig, sensor: Option<&SensorModel>) -> Result<Image, FuseError> {
    let (_, looks) = Caminal::new(config, sensor.cloned()).look(grid(), scan)?;
    let size = |edge: fn(&super::caminal::Look) -> u32| looks.first().map_or(0, edge) as usize;
    let (width, height) = (size(|look| look.camera.width), size(|look| look.camera.height));
    Ok(draw(width * looks.len(), height, |row, column| {
        let depths_m = &looks[column / width].image.depths_m;
        depth_color(depths_m[row * width + column % width])
    }))
}

/// Any grid: pictures show no voxels.
fn grid() -> Grid {
    Grid::new(1.0)
}

fn place(scan: &Scan) -> Result<Placed, FuseError> {
    let mut placed = Placed::default();
    placed.place(grid(), scan)?;
    Ok(placed)
}

fn origins(placed: &Placed) -> Option<&[Vec3]> {
    Some(placed.origins.as_slice()).filter(|origins| !origins.is_empty())
}

/// An image of these colours by row and column.
fn draw(width: usize, height: usize, color: impl Fn(usize, usize) -> Option<[u8; 3]>) -> Image {
    let pixels = (0..height).flat_map(|row| (0..width).map(move |column| (row, column)));
    Image {
        width,
        height,
        pixels: Pixels::Rgb(
            pixels
                .map(|(row, column)| color(row, column).unwrap_or_default())
                .collect(),
        ),
    }
}

/// The colour of a depth; 0 is none.
fn depth_color(depth_m: f32) -> Option<[u8; 3]> {
    let [near, far] = DEPTH_RANGE_M;
    let share = (depth_m / near).ln() / (far / near).ln();
    (depth_m > 0.0).then(|| viridis(share.clamp(0.0, 1.0)))
}

/// Draws a disc into a panorama of depths and colours, behind nearer ones.
fn splat(surfel: &Surfel, panorama: &CylindricalProjection, world_from_sensor: Mat3, nearest: &mut [(f32, [u8; 3])]) {
    let [center, normal] = [surfel.center, surfel.normal].map(|v| world_from_sensor.transpose() * v);
    let (radius, distance) = (surfel.radius_m, center.truncate().length());
    let (columns, rows) = (panorama.columns(), panorama.rows());
    // The pixels in which its bounding sphere is seen; all, if the axis of the sensor passes through the sphere.
    let (mut beside, mut high, mut low) = (columns as f32, 0.0, (rows - 1) as f32);
    if distance > 1.01 * radius {
        beside = (radius / distance).asin() / panorama.pitch();
        let row = |z: f32, depth: f32| panorama.project(Vec3::new(depth, 0.0, z)).row;
        let ends = [distance - radius, distance + radius];
        high = ends
            .map(|depth| row(center.z + radius, depth))
            .into_iter()
            .fold(low, f32::min)
            .max(high);
        low = ends
            .map(|depth| row(center.z - radius, depth))
            .into_iter()
            .fold(high, f32::max)
            .min(low);
    }
    let middle = panorama.project(center).column;
    let half = (beside + 1.0).min(0.5 * columns as f32) as i64;
    let across = normal.dot(center);
    for row in high as usize..=(low as usize + 1).min(rows - 1) {
        for column in (-half..=half).map(|off| (middle as i64 + off).rem_euclid(columns as i64) as usize) {
            let ray = panorama.unproject(row, column, 1.0);
            let depth = across / normal.dot(ray);
            let pixel = &mut nearest[row * columns + column];
            // Also false for NaN, where the ray lies in the plane.
            if depth > 0.0 && depth < pixel.0 && (ray * depth - center).length() <= radius {
                *pixel = (depth, normal_color(surfel.normal));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};

    use super::*;
    use crate::{
        Pose,
        sensor::{model, testing::scan_room},
    };

    /// A sweep in a room of 24 × 14 × 5 m, with a pose of its own.
    fn sweep(sensor: &SensorModel) -> Scan {
        let (points, rings) = scan_room(sensor, |_| 0.0);
        Scan {
            points,
            rings: Some(rings),
            pose: Some(Pose {
                rotation: DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2),
                translation: DVec3::new(4e5, 5e6, 300.0),
            }),
            ..Default::default()
        }
    }

    fn pictures(config: &FuseConfig) -> [Image; 5] {
        let sensor = model("os0-128").unwrap();
        Picture::ALL.map(|picture| picture.of(&sweep(&sensor), config, Some(&sensor)).unwrap())
    }

    fn colors(image: &Image) -> &[[u8; 3]] {
        match &image.pixels {
            Pixels::Rgb(colors) => colors,
            other => panic!("{other:?}"),
        }
    }

    /// The colour at shares of the width and the height.
    fn at(image: &Image, column: f64, row: f64) -> [u8; 3] {
        let pixel = |share: f64, size: usize| (share * size as f64) as usize;
        colors(image)[pixel(row, image.height) * image.width + pixel(column, image.width)]
    }

    fn empty(image: &Image) -> usize {
        colors(image).iter().filter(|color| **color == [0; 3]).count()
    }

    #[test]
    fn normals_and_surfels_show_which_way_surfaces_face() {
        let mut config = FuseConfig::default();
        // Discs without gaps between them.
        (config.surfel.finest_cell_m, config.surfel.radius_sigmas) = (0.8, 3.0);
        let [normals, surfels, ..] = pictures(&config);
        assert_eq!(
            (normals.width, normals.height),
            (model("os0-128").unwrap().columns as usize, 128)
        );
        assert!(surfels.height > 300);
        for (image, tolerance) in [(&normals, 1), (&surfels, 12)] {
            // Turned by 90°, the sensor looks along y. Walls face it: ahead, right, behind, left; then floor and ceiling.
            let expected = [
                ((0.02, 0.5), [128, 0, 128]),
                ((0.25, 0.5), [0, 128, 128]),
                ((0.52, 0.5), [128, 255, 128]),
                ((0.75, 0.5), [255, 128, 128]),
                ((0.25, 0.95), [128, 128, 255]),
                ((0.25, 0.05), [128, 128, 0]),
            ];
            for ((column, row), color) in expected {
                let seen = at(image, column, row);
                let near = seen
                    .iter()
                    .zip(color)
                    .all(|(a, b): (&u8, u8)| a.abs_diff(b) <= tolerance);
                assert!(
                    near,
                    "{} rows, {} of {} empty, at {column} {row}: {seen:?}, not {color:?}",
                    image.height,
                    empty(image),
                    image.height * image.width
                );
            }
        }
    }

    #[test]
    fn nearer_discs_hide_farther_ones_and_flipped_ones_show() {
        let sensor = model("vlp16").unwrap();
        let panorama = CylindricalProjection::new(&sensor, 0.0, 0.0, MARGIN);
        let disc = |x: f32, radius_m: f32, normal: Vec3| Surfel {
            center: Vec3::new(x, 0.0, 0.0),
            normal,
            radius_m,
            distance_m: x,
            points: 9,
        };
        let drawn = |discs: &[Surfel]| {
            let mut nearest = vec![(f32::INFINITY, [0; 3]); panorama.rows() * panorama.columns()];
            discs
                .iter()
                .for_each(|d| splat(d, &panorama, Mat3::IDENTITY, &mut nearest));
            nearest
        };
        let (near, far) = (disc(5.0, 0.5, -Vec3::X), disc(10.0, 2.0, Vec3::X));
        let [both, turned, alone] = [&[near, far][..], &[far, near], &[far]].map(drawn);
        assert_eq!(both, turned);
        let count = |pixels: &[(f32, [u8; 3])], x: f32| {
            pixels.iter().filter(|p| p.1 == normal_color(Vec3::X * x)).count() as f32
        };
        // Areas on a cylinder, in pixels: π (r/d/pitch)².
        let area = |radius: f32, x: f32| std::f32::consts::PI * (radius / x / panorama.pitch()).powi(2);
        assert!((count(&both, -1.0) / area(0.5, 5.0) - 1.0).abs() < 0.05);
        assert!((count(&alone, 1.0) / area(2.0, 10.0) - 1.0).abs() < 0.05);
        assert_eq!(count(&both, 1.0) + count(&both, -1.0), count(&alone, 1.0));
        // All around the sensor, and behind it.
        let floor = Surfel {
            center: Vec3::Z * -0.5,
            ..disc(0.0, 50.0, Vec3::Z)
        };
        let lowest = panorama.columns() * (panorama.rows() - 1);
        assert!(drawn(&[floor])[lowest..].iter().all(|p| p.1 == normal_color(Vec3::Z)));
    }

    #[test]
    fn filled_images_keep_what_is_measured_and_fill_as_far_as_they_are_told() {
        let sensor = model("pandar64").unwrap();
        let scan = sweep(&sensor);
        let with = |max_gap_deg| filled(&scan, KuehnerConfig { max_gap_deg }, Some(&sensor)).unwrap();
        let (measured, some, all) = (cylindrical(&scan, Some(&sensor)).unwrap(), with(1.0), with(180.0));
        assert!(empty(&measured) > empty(&some) && empty(&all) < all.height * all.width / 8);
        assert!(
            empty(&some) > some.height * some.width / 4,
            "gaps of 6 degrees keep holes"
        );
        // All rows are within what the widest fill adds above and below.
        let middle = |image: &Image, of: &Image| {
            let skip = (image.height - of.height) / 2 * image.width;
            colors(image)[skip..skip + colors(of).len()].to_vec()
        };
        let pairs = middle(&all, &measured).into_iter().zip(colors(&measured).to_vec());
        let (mut kept, mut lost) = (0, 0);
        for (filled, measured) in pairs.filter(|(_, measured)| *measured != [0; 3]) {
            (kept, lost) = if filled == measured {
                (kept + 1, lost)
            } else {
                (kept, lost + 1)
            };
        }
        assert!(kept > 100_000 && lost == 0, "{kept} {lost}");
        let [low, high] = DEPTH_RANGE_M;
        assert_eq!(
            [0.0, 0.1 * low, low, high, 9.0 * high].map(depth_color),
            [
                None,
                Some([68, 1, 84]),
                Some([68, 1, 84]),
                Some([253, 231, 37]),
                Some([253, 231, 37]),
            ]
        );
    }

    #[test]
    fn interpolated_images_show_all_cameras() {
        let sensor = model("pandar64").unwrap();
        let scan = sweep(&sensor);
        let with = |max_gap_deg, cameras| {
            let config = CaminalConfig { cameras, max_gap_deg };
            interpolated(&scan, config, Some(&sensor)).unwrap()
        };
        let (measured, some, one) = (with(0.0, 4), with(2.0, 4), with(2.0, 1));
        assert_eq!((measured.width, measured.height), (4 * one.width, one.height));
        assert!(empty(&some) < empty(&measured) * 3 / 4);
        let pairs = colors(&measured).iter().zip(colors(&some));
        assert!(
            pairs
                .filter(|(measured, _)| **measured != [0; 3])
                .all(|(measured, some)| measured == some)
        );
        // Ahead it is 12 m to the wall, to the right 7.
        assert!(at(&some, 0.125, 0.35)[1] > at(&some, 0.375, 0.35)[1] + 20);
    }

    #[test]
    fn scans_without_beams_have_no_images_but_surfels() {
        let told = |picture: Picture, scan: &Scan| {
            picture
                .of(scan, &FuseConfig::default(), None)
                .err()
                .map(|e| e.to_string())
        };
        let random = |i: usize| crate::sensor::testing::random(i) - 0.5;
        let cloud = Scan {
            name: "cloud".into(),
            points: (0..3000)
                .map(|i| Vec3::new(random(3 * i), random(3 * i + 1), random(3 * i + 2)) * 20.0)
                .collect(),
            pose: Some(Pose::IDENTITY),
            ..Default::default()
        };
        for picture in Picture::ALL {
            let refused = told(picture, &cloud).is_some_and(|told| told.contains("cloud: no laser beams show"));
            assert_eq!(refused, picture != Picture::Surfels, "{}", picture.name());
        }
    }
}
