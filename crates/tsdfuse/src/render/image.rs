//! Views as pictures: plain pixels, no files.

use glam::Vec3;

use super::view::{Hit, View};

/// Units of a depth image in a metre.
pub const DEPTH_PER_M: f32 = 1000.0;

/// The weights at the dark and at the bright end of the colours; between them they are logarithmic.
pub const WEIGHT_RANGE: [f32; 2] = [0.01, 100.0];

/// What a picture shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ImageKind {
    /// The surface as lit by a lamp beside the camera and by the sky; grey on white.
    #[default]
    Shaded,
    /// Normals as colours: red, green, blue = ½ + ½·(x, y, z), world axes; black where there is no surface.
    Normal,
    /// Depths ([`Hit::depth_m`]) in millimetres, 16 bits; 0 where there is no surface, 65535 from 65.535 m on.
    Depth,
    /// Weights in the colours of "viridis", logarithmic over [`WEIGHT_RANGE`]; black where there is no surface.
    Weight,
}

impl ImageKind {
    /// All there are.
    pub const ALL: [Self; 4] = [Self::Shaded, Self::Normal, Self::Depth, Self::Weight];

    /// Its name in lower case.
    pub fn name(self) -> &'static str {
        match self {
            Self::Shaded => "shaded",
            Self::Normal => "normal",
            Self::Depth => "depth",
            Self::Weight => "weight",
        }
    }
}

/// A picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row by row from the top left.
    pub pixels: Pixels,
}

/// The pixels of a picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Pixels {
    /// Brightness, 8 bits.
    Grey(Vec<u8>),
    /// A number in 16 bits.
    Grey16(Vec<u16>),
    /// Red, green and blue in 8 bits each.
    Rgb(Vec<[u8; 3]>),
}

impl View {
    /// A picture of what is seen.
    pub fn image(&self, kind: ImageKind) -> Image {
        let pixels = match kind {
            ImageKind::Shaded => Pixels::Grey(self.each(255, shade)),
            ImageKind::Normal => Pixels::Rgb(self.each([0; 3], |h| normal_color(h.normal))),
            ImageKind::Depth => Pixels::Grey16(self.each(0, depth)),
            ImageKind::Weight => Pixels::Rgb(self.each([0; 3], |h| viridis(log_share(h.weight)))),
        };
        Image {
            width: self.width,
            height: self.height,
            pixels,
        }
    }

    fn each<T: Copy>(&self, nothing: T, pixel: impl Fn(&Hit) -> T) -> Vec<T> {
        let pixel = |hit: &Option<Hit>| hit.as_ref().map_or(nothing, &pixel);
        self.hits.iter().map(pixel).collect()
    }
}

/// The colour of a normal: ½ + ½·(x, y, z).
pub(crate) fn normal_color(normal: Vec3) -> [u8; 3] {
    normal.to_array().map(|n| byte(0.5 + 0.5 * n))
}

/// 0..=1 in 8 bits.
fn byte(x: f32) -> u8 {
    (x.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

/// Some light from everywhere, more from the camera (Lambert), some from above.
fn shade(hit: &Hit) -> u8 {
    let lamp = hit.incidence_cos.abs();
    let sky = 0.5 + 0.5 * hit.normal.z;
    byte(0.06 + 0.58 * lamp + 0.28 * sky)
}

fn depth(hit: &Hit) -> u16 {
    // A conversion saturates. What is seen is not nothing, however near.
    ((hit.depth_m * DEPTH_PER_M + 0.5) as u16).max(1)
}

/// Where a weight lies in [`WEIGHT_RANGE`], 0..=1.
fn log_share(weight: f32) -> f32 {
    let [low, high] = WEIGHT_RANGE;
    ((weight / low).ln() / (high / low).ln()).clamp(0.0, 1.0)
}

/// The colour map "viridis" (Smith, van der Walt and Firing 2015), at ninths.
const VIRIDIS: [[f32; 3]; 10] = [
    [68.0, 1.0, 84.0],
    [72.0, 40.0, 120.0],
    [62.0, 73.0, 137.0],
    [49.0, 104.0, 142.0],
    [38.0, 130.0, 142.0],
    [31.0, 158.0, 137.0],
    [53.0, 183.0, 121.0],
    [110.0, 206.0, 88.0],
    [181.0, 222.0, 43.0],
    [253.0, 231.0, 37.0],
];

/// The colour of "viridis" (Smith, van der Walt and Firing 2015) at a share of its range, 0..=1.
pub fn viridis(share: f32) -> [u8; 3] {
    let at = share * 9.0;
    let low = (at as usize).min(8);
    let s = at - low as f32;
    std::array::from_fn(|c| (VIRIDIS[low][c] * (1.0 - s) + VIRIDIS[low + 1][c] * s + 0.5) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(hits: Vec<Option<Hit>>) -> View {
        View {
            width: hits.len(),
            height: 1,
            hits,
        }
    }

    fn hit(depth_m: f32, weight: f32) -> Option<Hit> {
        Some(Hit {
            range_m: 2.0 * depth_m,
            depth_m,
            normal: Vec3::Z,
            incidence_cos: 0.5,
            weight,
        })
    }

    #[test]
    fn depths_are_millimetres_and_nothing_is_0() {
        let depths = [0.0001, 1.0, 12.3456, 65.534, 65.535, 1e6, f32::INFINITY];
        let hits = depths.iter().map(|&d| hit(d, 1.0)).chain([None]).collect();
        let pixels = Pixels::Grey16(vec![1, 1000, 12346, 65534, 65535, 65535, 65535, 0]);
        assert_eq!(view(hits).image(ImageKind::Depth).pixels, pixels);
    }

    #[test]
    fn colours_of_weights_are_logarithmic_and_end_where_they_say() {
        let [low, high] = WEIGHT_RANGE;
        let weights = [0.0, low, (low * high).sqrt(), high, 1e9];
        let hits = weights.iter().map(|&w| hit(1.0, w)).chain([None]).collect();
        let (dark, bright) = ([68, 1, 84], [253, 231, 37]);
        let middle = [35, 144, 140];
        let pixels = Pixels::Rgb(vec![dark, dark, middle, bright, bright, [0; 3]]);
        assert_eq!(view(hits).image(ImageKind::Weight).pixels, pixels);
    }

    #[test]
    fn normals_are_colours_and_light_falls_with_incidence() {
        let hits = vec![hit(1.0, 1.0), None];
        let pixels = Pixels::Rgb(vec![[128, 128, 255], [0; 3]]);
        assert_eq!(view(hits).image(ImageKind::Normal).pixels, pixels);
        let shades: Vec<_> = [1.0, 0.5, 0.0]
            .map(|incidence_cos| hit(1.0, 1.0).map(|h| Hit { incidence_cos, ..h }))
            .into_iter()
            .chain([None])
            .collect();
        let Pixels::Grey(shades) = view(shades).image(ImageKind::Shaded).pixels else {
            panic!("shaded pictures are grey")
        };
        assert!(
            shades[3] == 255 && shades.windows(2).take(2).all(|w| w[0] > w[1] + 30),
            "{shades:?}"
        );
        // Surface never looks like background.
        assert!(shades[0] < 240);
    }
}
