//! How a method is drawn in plots: a colour for the method, and a pattern for its form.

use tsdfuse::fuse::Method;

use crate::results::Row;

/// How a form is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Style {
    color: [u8; 3],
    /// Length of dashes and of gaps; none for a solid line.
    pub(crate) dashes: Option<(i32, i32)>,
}

/// The color of text on the page, which is dark on light paper and light on dark paper.
pub(crate) const TEXT: &str = "currentColor";

/// The patterns of a method's forms other than its default; the last one is for all further ones.
const DASHES: [(i32, i32); 3] = [(5, 4), (2, 3), (10, 3)];

impl Style {
    /// Of each row: the method's colour, solid for its default form, and another pattern for each other form.
    pub(crate) fn of(rows: &[Row]) -> Vec<Self> {
        let style = |(number, row): (usize, &Row)| {
            let is_other = |other: &&Row| other.form.method == row.form.method && !other.form.settings.is_empty();
            let before = rows[..number].iter().filter(is_other).count();
            Self {
                color: color(row.form.method),
                dashes: (!row.form.settings.is_empty()).then(|| DASHES[before.min(DASHES.len() - 1)]),
            }
        };
        rows.iter().enumerate().map(style).collect()
    }

    /// Red, green, blue; black stands for [`TEXT`].
    pub(crate) fn rgb(&self) -> [u8; 3] {
        self.color
    }

    /// As CSS.
    pub(crate) fn css(&self) -> String {
        match self.color {
            BLACK => TEXT.to_owned(),
            [r, g, b] => format!("rgb({r} {g} {b})"),
        }
    }

    /// The CSS style of a border.
    pub(crate) fn border(&self) -> &'static str {
        match self.dashes {
            None => "solid",
            Some((dash, _)) if dash < DASHES[0].0 => "dotted",
            Some(_) => "dashed",
        }
    }
}

const BLACK: [u8; 3] = [0; 3];

/// After Okabe and Ito, "Color Universal Design", 2008, as far as that goes.
const COLORS: [[u8; 3]; 8] = [
    [0, 114, 178],
    [213, 94, 0],
    [0, 158, 115],
    [204, 121, 167],
    [230, 159, 0],
    [86, 180, 233],
    [140, 109, 49],
    [127, 63, 191],
];

/// Black for the default method; the others take the colours in turn.
fn color(method: Method) -> [u8; 3] {
    if method == Method::default() {
        return BLACK;
    }
    let mut others = Method::ALL.iter().filter(|other| **other != Method::default());
    let number = others.position(|other| *other == method).unwrap_or_default();
    COLORS[number % COLORS.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colors_can_be_told_apart() {
        let distance = |a: [u8; 3], b: [u8; 3]| -> f64 {
            let squares = a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(b)).powi(2));
            squares.sum::<f64>().sqrt()
        };
        for (i, a) in Method::ALL.iter().enumerate() {
            for b in &Method::ALL[..i] {
                let apart = distance(color(*a), color(*b));
                assert!(apart > 60.0, "{} and {}: {apart}", a.name(), b.name());
            }
            // Text and the method in its colour stand on light and on dark paper.
            assert!(color(*a) == BLACK || distance(color(*a), BLACK) > 60.0);
        }
    }
}
