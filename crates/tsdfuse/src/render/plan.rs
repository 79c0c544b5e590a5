//! Slices of the map as pictures with a scale.

use super::image::{Image, Pixels};
use crate::raster::Raster;

/// Rows of the scale below a picture.
const STRIP: usize = 28;

/// Pixels of a picture without its scale, at least, along its longer edge.
const LEAST: usize = 600;

const SURFACE: [u8; 3] = [20, 24, 32];
const FREE: [u8; 3] = [255, 255, 255];
const BEHIND: [u8; 3] = [176, 190, 208];
const UNKNOWN: [u8; 3] = [226, 226, 222];

/// A slice ([`Raster::slice`]) as a picture: surface black, what lies before it white, behind it blue-grey, what was never observed
/// grey. Below it stands a scale. Small slices are enlarged by whole pixels.
pub fn plan(slice: &Raster) -> Image {
    let scale = (LEAST / slice.width.max(slice.height).max(1)).max(1);
    let (width, height) = ((slice.width * scale).max(STRIP * 4), slice.height * scale);
    let mut canvas = Canvas {
        width,
        pixels: vec![UNKNOWN; width * height],
    };
    canvas.pixels.resize(width * (height + STRIP), FREE);
    for row in 0..slice.height {
        for column in 0..slice.width {
            let color = color(slice, column, row);
            canvas.fill([column * scale, row * scale], [scale, scale], color);
        }
    }
    canvas.scale([STRIP / 3, height + STRIP - 8], slice.cell_m / scale as f64);
    Image {
        width,
        height: height + STRIP,
        pixels: Pixels::Rgb(canvas.pixels),
    }
}

/// Surface lies where the sign changes towards the right or below, and where the distance is less than half a cell.
fn color(slice: &Raster, column: usize, row: usize) -> [u8; 3] {
    let at = |column: usize, row: usize| slice.values[row * slice.width + column];
    let here = at(column, row);
    let changes = |there: f32| here * there < 0.0;
    let is_surface = 2.0 * f64::from(here.abs()) < slice.cell_m
        || (column + 1 < slice.width && changes(at(column + 1, row)))
        || (row + 1 < slice.height && changes(at(column, row + 1)));
    match here {
        _ if is_surface => SURFACE,
        x if x > 0.0 => FREE,
        x if x < 0.0 => BEHIND,
        _ => UNKNOWN,
    }
}

struct Canvas {
    width: usize,
    pixels: Vec<[u8; 3]>,
}

impl Canvas {
    fn fill(&mut self, [x, y]: [usize; 2], [width, height]: [usize; 2], color: [u8; 3]) {
        for row in y..y + height {
            let end = (x + width).min(self.width);
            if let Some(pixels) = self
                .pixels
                .get_mut(row * self.width + x.min(end)..row * self.width + end)
            {
                pixels.fill(color);
            }
        }
    }

    /// A bar of a round length and its length, with its lower left corner here; pixels of so many metres.
    fn scale(&mut self, [x, y]: [usize; 2], pixel_m: f64) {
        let most_m = 0.4 * self.width as f64 * pixel_m;
        let ten = 10f64.powf(most_m.log10().floor());
        let length_m = [5.0, 2.0, 1.0]
            .into_iter()
            .map(|n| n * ten)
            .find(|&m| m <= most_m)
            .unwrap_or(ten);
        let length = (length_m / pixel_m).round() as usize;
        self.fill([x, y - 3], [length, 3], SURFACE);
        for end in [x, x + length - 2.min(length)] {
            self.fill([end, y - 9], [2, 9], SURFACE);
        }
        let text = if length_m < 1.0 {
            format!("{} cm", (100.0 * length_m).round())
        } else {
            format!("{length_m} m")
        };
        self.write([x + length + 8, y - 10], &text);
    }

    fn write(&mut self, [mut x, y]: [usize; 2], text: &str) {
        for letter in text.chars() {
            let rows = GLYPHS
                .iter()
                .find(|(glyph, _)| *glyph == letter)
                .map_or([0; 5], |(_, rows)| *rows);
            for (row, bits) in rows.iter().enumerate() {
                for column in (0..5).filter(|column| bits >> (4 - column) & 1 == 1) {
                    self.fill([x + 2 * column, y + 2 * row], [2, 2], SURFACE);
                }
            }
            x += if letter == 'm' { 12 } else { 8 };
        }
    }
}

/// Letters of a scale: five rows of five bits, the first one left.
const GLYPHS: [(char, [u8; 5]); 12] = [
    ('0', [0b11100, 0b10100, 0b10100, 0b10100, 0b11100]),
    ('1', [0b01000, 0b11000, 0b01000, 0b01000, 0b11100]),
    ('2', [0b11100, 0b00100, 0b11100, 0b10000, 0b11100]),
    ('3', [0b11100, 0b00100, 0b11100, 0b00100, 0b11100]),
    ('4', [0b10100, 0b10100, 0b11100, 0b00100, 0b00100]),
    ('5', [0b11100, 0b10000, 0b11100, 0b00100, 0b11100]),
    ('6', [0b11100, 0b10000, 0b11100, 0b10100, 0b11100]),
    ('7', [0b11100, 0b00100, 0b00100, 0b01000, 0b01000]),
    ('8', [0b11100, 0b10100, 0b11100, 0b10100, 0b11100]),
    ('9', [0b11100, 0b10100, 0b11100, 0b00100, 0b11100]),
    ('m', [0b00000, 0b11110, 0b10101, 0b10101, 0b10101]),
    ('c', [0b00000, 0b11100, 0b10000, 0b10000, 0b11100]),
];

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec2;

    #[test]
    fn what_is_known_has_its_colour_and_the_bar_its_length() {
        let mut slice = Raster::covering(DVec2::ZERO, DVec2::new(60.0, 10.0), 0.1).unwrap();
        // A wall along the middle, observed on its right half only.
        for row in 0..slice.height {
            for column in slice.width / 2..slice.width {
                slice.values[row * slice.width + column] = 0.1 * (row as f32 - 49.3);
            }
        }
        let image = plan(&slice);
        assert_eq!((image.width, image.height), (600, 100 + STRIP));
        let Pixels::Rgb(pixels) = &image.pixels else {
            panic!("colours are wanted")
        };
        let at = |x: usize, y: usize| pixels[y * 600 + x];
        assert_eq!(
            [at(10, 50), at(500, 10), at(500, 90), at(500, 49)],
            [UNKNOWN, BEHIND, FREE, SURFACE]
        );
        let bar = (0..214).filter(|&x| at(x, 100 + STRIP - 10) == SURFACE).count();
        assert_eq!(bar, 200); // 20 m
        // Written beside it: 20 m.
        let ink = (218..270)
            .flat_map(|x| (108..122).map(move |y| (x, y)))
            .filter(|&(x, y)| at(x, y) == SURFACE)
            .count();
        assert!(ink > 80, "{ink}");
    }
}
