//! A table whose rows are methods and whose columns are figures: as text, Markdown and HTML.

use crate::html::escape;
use crate::results::Row;

/// A table. The first column holds the names of the methods.
#[derive(Clone, Debug, Default)]
pub struct Table {
    /// What it is about.
    pub title: String,
    /// What the figures are.
    pub note: String,
    head: Vec<&'static str>,
    better: Vec<Better>,
    rows: Vec<(String, Vec<Cell>)>,
}

/// Which values of a column are good.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Better {
    Less,
    More,
    Neither,
}

/// A figure and how it is written.
#[derive(Clone, Debug)]
struct Cell {
    value: Option<f64>,
    text: String,
}

/// How a column is made.
pub(crate) struct Column {
    head: &'static str,
    better: Better,
    decimals: usize,
    of: fn(&Row) -> Option<f64>,
}

pub(crate) const fn column(head: &'static str, better: Better, decimals: usize, of: fn(&Row) -> Option<f64>) -> Column {
    Column {
        head,
        better,
        decimals,
        of,
    }
}

impl Table {
    pub(crate) fn new(title: &str, note: String, columns: &[Column], rows: &[Row]) -> Self {
        let cell = |column: &Column, row: &Row| {
            let value = (column.of)(row).filter(|v| v.is_finite());
            let text = value.map_or("–".to_owned(), |v| format!("{v:.*}", column.decimals));
            Cell { value, text }
        };
        let row = |row: &Row| (row.form.name.clone(), columns.iter().map(|c| cell(c, row)).collect());
        Self {
            title: title.to_owned(),
            note,
            head: columns.iter().map(|c| c.head).collect(),
            better: columns.iter().map(|c| c.better).collect(),
            rows: rows.iter().map(row).collect(),
        }
    }

    /// Adds to the text of the first figure of a row.
    pub(crate) fn append(&mut self, row: usize, text: &str) {
        let cell = self.rows.get_mut(row).and_then(|(_, cells)| cells.first_mut());
        cell.into_iter().for_each(|cell| cell.text += text);
    }

    /// Whether a cell holds the best value of its column, as it is written.
    fn is_best(&self, cells: &[Cell], column: usize) -> bool {
        let values = || self.rows.iter().filter_map(|(_, cells)| cells[column].value);
        let best = match self.better[column] {
            Better::Neither => None,
            Better::Less => values().reduce(f64::min),
            Better::More => values().reduce(f64::max),
        };
        let is_best =
            |(_, other): &(String, Vec<Cell>)| other[column].value == best && other[column].text == cells[column].text;
        best.is_some() && self.rows.len() > 1 && self.rows.iter().any(is_best)
    }

    /// For a terminal.
    pub fn text(&self) -> String {
        let mut lines = vec![vec![String::new()]];
        lines[0].extend(self.head.iter().map(|h| h.trim().to_owned()));
        for (name, cells) in &self.rows {
            let cells = cells.iter().map(|cell| cell.text.clone());
            lines.push(std::iter::once(name.clone()).chain(cells).collect());
        }
        let width = |column: usize| lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..=self.head.len()).map(width).collect();
        let mut text = format!("{}\n", self.title);
        for line in &lines {
            let name = format!("  {:<1$}", line[0], widths[0]);
            let figures = line[1..]
                .iter()
                .zip(&widths[1..])
                .map(|(figure, width)| format!("  {figure:>width$}"));
            text += &(name + &figures.collect::<String>());
            text.push('\n');
        }
        text
    }

    /// A Markdown table; the best of each column is bold.
    pub fn markdown(&self) -> String {
        let mut text = format!("**{}.** {}\n\n| |", self.title, self.note);
        text.extend(self.head.iter().map(|head| format!(" {} |", head.trim())));
        text += "\n|---|";
        text += &"---|".repeat(self.head.len());
        text.push('\n');
        for (name, cells) in &self.rows {
            text += &format!("| `{name}` |");
            for (column, cell) in cells.iter().enumerate() {
                let bold = if self.is_best(cells, column) { "**" } else { "" };
                text += &format!(" {bold}{}{bold} |", cell.text);
            }
            text.push('\n');
        }
        text
    }

    /// An HTML table; the best of each column is bold.
    pub fn html(&self) -> String {
        let mut html = format!(
            "<h2>{}</h2>\n<p>{}</p>\n<div class=\"wide\"><table><tr><th></th>",
            self.title,
            escape(&self.note)
        );
        html.extend(self.head.iter().map(|head| format!("<th>{}</th>", head.trim())));
        html += "</tr>\n";
        for (name, cells) in &self.rows {
            html += &format!("<tr><th>{}</th>", escape(name));
            for (column, cell) in cells.iter().enumerate() {
                let class = if self.is_best(cells, column) {
                    " class=\"best\""
                } else {
                    ""
                };
                html += &format!("<td{class}>{}</td>", cell.text);
            }
            html += "</tr>\n";
        }
        html + "</table></div>\n"
    }
}
