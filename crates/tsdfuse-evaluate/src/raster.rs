//! Plots as pixels: a backend of `plotters` that needs no fonts of the system.

use std::convert::Infallible;

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};
use plotters_backend::text_anchor::{HPos, VPos};
use plotters_backend::{
    BackendColor, BackendCoord, BackendStyle, BackendTextStyle, DrawingBackend, DrawingErrorKind, rasterizer,
};
use tsdfuse::render::{Image, Pixels};

/// Pixels along each axis for one of the plot.
const SCALE: i32 = 2;
/// All text has this height.
const FONT: (FontWeight, RasterHeight) = (FontWeight::Regular, RasterHeight::Size24);

type Drawn = Result<(), DrawingErrorKind<Infallible>>;

/// A picture that is drawn, at twice the size that it tells.
pub(crate) struct Raster<'a>(pub(crate) &'a mut Canvas);

/// The picture's own pixels.
pub(crate) struct Canvas {
    width: usize,
    pixels: Vec<[u8; 3]>,
}

/// A style of twice the width.
struct Wide<'a, S>(&'a S);

impl<S: BackendStyle> BackendStyle for Wide<'_, S> {
    fn color(&self) -> BackendColor {
        self.0.color()
    }

    fn stroke_width(&self) -> u32 {
        self.0.stroke_width() * SCALE as u32
    }
}

impl Canvas {
    /// White, for a plot of this size.
    pub(crate) fn new((width, height): (u32, u32)) -> Self {
        let [width, height] = [width, height].map(|edge| edge as usize * SCALE as usize);
        Self {
            width,
            pixels: vec![[255; 3]; width * height],
        }
    }

    pub(crate) fn into_image(self) -> Image {
        Image {
            width: self.width,
            height: self.pixels.len() / self.width.max(1),
            pixels: Pixels::Rgb(self.pixels),
        }
    }
}

impl DrawingBackend for Canvas {
    type ErrorType = Infallible;

    fn get_size(&self) -> (u32, u32) {
        (self.width as u32, (self.pixels.len() / self.width.max(1)) as u32)
    }

    fn ensure_prepared(&mut self) -> Drawn {
        Ok(())
    }

    fn present(&mut self) -> Drawn {
        Ok(())
    }

    fn draw_pixel(&mut self, (x, y): BackendCoord, BackendColor { alpha, rgb }: BackendColor) -> Drawn {
        let at = usize::try_from(x).ok().zip(usize::try_from(y).ok());
        let at = at.filter(|(x, _)| *x < self.width).map(|(x, y)| y * self.width + x);
        if let Some(pixel) = at.and_then(|at| self.pixels.get_mut(at)) {
            for (old, new) in pixel.iter_mut().zip([rgb.0, rgb.1, rgb.2]) {
                *old = (f64::from(*old) * (1.0 - alpha) + f64::from(new) * alpha).round() as u8;
            }
        }
        Ok(())
    }
}

fn wide((x, y): BackendCoord) -> BackendCoord {
    (x * SCALE, y * SCALE)
}

impl DrawingBackend for Raster<'_> {
    type ErrorType = Infallible;

    fn get_size(&self) -> (u32, u32) {
        let (width, height) = self.0.get_size();
        (width / SCALE as u32, height / SCALE as u32)
    }

    fn ensure_prepared(&mut self) -> Drawn {
        Ok(())
    }

    fn present(&mut self) -> Drawn {
        Ok(())
    }

    fn draw_pixel(&mut self, at: BackendCoord, color: BackendColor) -> Drawn {
        let (x, y) = wide(at);
        (0..SCALE * SCALE).try_for_each(|i| self.0.draw_pixel((x + i % SCALE, y + i / SCALE), color))
    }

    fn draw_line<S: BackendStyle>(&mut self, from: BackendCoord, to: BackendCoord, style: &S) -> Drawn {
        rasterizer::draw_line(self.0, wide(from), wide(to), &Wide(style))
    }

    fn draw_rect<S: BackendStyle>(&mut self, a: BackendCoord, b: BackendCoord, style: &S, fill: bool) -> Drawn {
        rasterizer::draw_rect(self.0, wide(a), wide(b), &Wide(style), fill)
    }

    fn draw_path<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(&mut self, path: I, style: &S) -> Drawn {
        let mut last = None;
        for next in path.into_iter().map(wide) {
            if let Some(from) = last.replace(next) {
                rasterizer::draw_line(self.0, from, next, &Wide(style))?;
                // Joints have no gaps.
                let radius = style.stroke_width() * SCALE as u32 / 2;
                rasterizer::draw_circle(self.0, next, radius, &Wide(style), true)?;
            }
        }
        Ok(())
    }

    fn draw_circle<S: BackendStyle>(&mut self, center: BackendCoord, radius: u32, style: &S, fill: bool) -> Drawn {
        rasterizer::draw_circle(self.0, wide(center), radius * SCALE as u32, &Wide(style), fill)
    }

    fn fill_polygon<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(&mut self, corners: I, style: &S) -> Drawn {
        let corners: Vec<_> = corners.into_iter().map(wide).collect();
        rasterizer::fill_polygon(self.0, &corners, &Wide(style))
    }

    fn draw_text<S: BackendTextStyle>(&mut self, text: &str, style: &S, at: BackendCoord) -> Drawn {
        let (width, height) = size(text);
        let (anchor, transform, color, (x, y)) = (style.anchor(), style.transform(), style.color(), wide(at));
        let left = match anchor.h_pos {
            HPos::Left => 0,
            HPos::Right => -width,
            HPos::Center => -width / 2,
        };
        let top = match anchor.v_pos {
            VPos::Top => 0,
            VPos::Center => -height / 2,
            VPos::Bottom => -height,
        };
        let (weight, raster) = FONT;
        let advance = get_raster_width(weight, raster) as i32;
        for (number, letter) in (0..).zip(text.chars()) {
            let Some(letter) = get_raster(letter, weight, raster) else {
                continue;
            };
            for (row, pixels) in (0..).zip(letter.rows()) {
                for (column, &shade) in (0..).zip(pixels).filter(|(_, shade)| **shade > 0) {
                    let (dx, dy) = transform.transform(left + number * advance + column, top + row);
                    let alpha = color.alpha * f64::from(shade) / 255.0;
                    self.0.draw_pixel((x + dx, y + dy), BackendColor { alpha, ..color })?;
                }
            }
        }
        Ok(())
    }

    fn estimate_text_size<S: BackendTextStyle>(
        &self,
        text: &str,
        _: &S,
    ) -> Result<(u32, u32), DrawingErrorKind<Infallible>> {
        let (width, height) = size(text);
        Ok(((width / SCALE) as u32, (height / SCALE) as u32))
    }
}

/// Width and height of a text in pixels.
fn size(text: &str) -> (i32, i32) {
    let (weight, height) = FONT;
    let letters = text.chars().count();
    ((letters * get_raster_width(weight, height)) as i32, height.val() as i32)
}
