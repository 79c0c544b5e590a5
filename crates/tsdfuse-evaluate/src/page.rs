//! The report: one HTML file with everything in it but the meshes in 3D, which are pages beside it.

use std::fmt::Write;

use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;

use crate::html::escape;
use crate::pictures::{Gallery, Shot};
use crate::plots::Plot;
use crate::results::Results;
use crate::style::Style;
use crate::table::Table;

const STYLE: &str = "\
:root { color-scheme: light dark; --line: #8884; --soft: #8882; }
body { font: 15px/1.5 system-ui, sans-serif; margin: 0 auto; padding: 1rem clamp(.7rem, 3vw, 2rem); max-width: 1200px; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin: 2rem 0 .3rem; } h3 { font-size: 1rem; margin: 1rem 0 .2rem; }
p { margin: .3rem 0 .7rem; max-width: 75ch; } code { overflow-wrap: anywhere; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .2rem .6rem; text-align: right; border-bottom: 1px solid var(--line); white-space: nowrap; }
tr th:first-child { text-align: left; position: sticky; left: 0; background: Canvas; } td.best { font-weight: 700; }
.plots, .shots { display: grid; gap: 1rem; grid-template-columns: repeat(auto-fill, minmax(min(100%, 30rem), 1fr)); }
.shots { gap: .5rem; grid-template-columns: repeat(auto-fill, minmax(min(100%, 17rem), 1fr)); }
figure { margin: 0; } svg, img { width: 100%; height: auto; display: block; } img { border-radius: 4px; background: #fff; }
iframe { width: 100%; height: 70vh; border: 1px solid var(--line); border-radius: 4px; } .links a { margin-right: 1rem; }
figcaption { font-size: .85rem; } .legend { display: flex; flex-wrap: wrap; gap: .2rem 1rem; font-size: .85rem; }
.legend i { display: inline-block; width: 1.6rem; margin-right: .35rem; vertical-align: middle; border-top: 3px solid; }
.scale { display: flex; align-items: center; gap: .5rem; font-size: .85rem; margin: .5rem 0; }
.scale span { width: 12rem; height: .8rem; border-radius: 2px; }
details { margin: .4rem 0; } summary { cursor: pointer; }
";

/// The page, with tables, plots and pictures in it.
pub fn of(results: &Results, tables: &[Table], plots: &[Plot], gallery: &Gallery) -> String {
    let name = escape(&results.dataset.name);
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{name}: tsdfuse evaluate</title>\n<style>\n{STYLE}</style></head><body>\n<h1>{name}</h1>\n{}",
        summary(results)
    );
    tables.iter().for_each(|table| page += &table.html());
    page += "<h2>Plots</h2>\n";
    page += &legend(results);
    page += "<div class=\"plots\">\n";
    for Plot { title, svg } in plots {
        page += &format!("<figure><figcaption>{title}</figcaption>\n{svg}</figure>\n");
    }
    page += "</div>\n";
    page += &in_3d(gallery);
    page += &pictures(gallery);
    page += "<h2>How to repeat it</h2>\n";
    for row in &results.methods {
        let (name, command) = (escape(&row.form.name), escape(&row.command));
        page += &format!("<details><summary>{name}</summary><code>{command}</code></details>\n");
    }
    page + "</body></html>\n"
}

/// What was compared with what, and what casts doubt on it.
fn summary(results: &Results) -> String {
    let (data, reference) = (&results.dataset, &results.reference);
    let mut html = format!(
        "<p>{} scans ({}), compared with {}. tsdfuse {}, {}, {} threads, {}.</p>\n",
        data.scans,
        escape(&data.format),
        escape(&reference.words),
        results.version,
        escape(results.machine.processor.as_deref().unwrap_or(&results.machine.system)),
        results.machine.threads,
        results.machine.date,
    );
    if let Some(noise) = data.pose_noise {
        html += &format!(
            "<p>Scans were fused with errors added to their poses: standard deviations of {} m and {}°.</p>\n",
            noise.position_m, noise.turn_deg
        );
    }
    let warnings = results
        .methods
        .iter()
        .flat_map(|row| row.surface.warnings.iter().map(|w| (&row.form.name, w)));
    let failed = results.failed.iter().map(|failed| (&failed.name, &failed.reason));
    for (name, text) in warnings.chain(failed) {
        html += &format!("<p><strong>{}</strong>: {}</p>\n", escape(name), escape(text));
    }
    html
}

fn legend(results: &Results) -> String {
    let mut html = "<div class=\"legend\">".to_owned();
    for (row, style) in results.methods.iter().zip(Style::of(&results.methods)) {
        // Writing to a string cannot fail.
        let _ = write!(
            html,
            "<span><i style=\"border-color: {}; border-style: {} none none\"></i>{}</span>",
            style.css(),
            style.border(),
            escape(&row.form.name)
        );
    }
    html + "</div>\n"
}

/// The meshes in the colours of their errors, one at a time: pages that lie beside the report.
fn in_3d(gallery: &Gallery) -> String {
    let Some((_, first)) = gallery.pages.first() else {
        return String::new();
    };
    let link = |(name, file): &(String, String)| {
        format!("<a href=\"{}\" target=\"in-3d\">{}</a>\n", escape(file), escape(name))
    };
    let links: String = gallery.pages.iter().map(link).collect();
    format!(
        "<h2>In 3D</h2>\n<p>Colours are distances to the reference; the pointer tells them. Drag to turn, right-drag to move, wheel to come \
         nearer.</p>\n<p class=\"links\">{links}</p>\n<iframe name=\"in-3d\" loading=\"lazy\" title=\"A mesh in 3D\" src=\"{}\"></iframe>\n",
        escape(first)
    )
}

fn pictures(gallery: &Gallery) -> String {
    let mut html = String::new();
    for (number, view) in gallery.views.iter().enumerate() {
        let shots = || gallery.shots.iter().filter(move |shot| shot.view == number);
        html += &format!(
            "<h2>{}</h2>\n<p>Black is the back of a surface.</p>\n<div class=\"shots\">\n",
            escape(view)
        );
        shots().for_each(|shot| html += &figure(shot, &shot.surface));
        html += "</div>\n";
        if shots().any(|shot| shot.error.is_some()) {
            html += "<h3>Distance to the reference</h3>\n";
            html += &scale(gallery);
            html += "<div class=\"shots\">\n";
            shots()
                .filter_map(|shot| Some((shot, shot.error.as_ref()?)))
                .for_each(|(shot, png)| html += &figure(shot, png));
            html += "</div>\n";
        }
    }
    html
}

fn figure(shot: &Shot, png: &[u8]) -> String {
    let name = escape(&shot.name);
    let data = BASE64.encode(png);
    format!(
        "<figure><img loading=\"lazy\" alt=\"{name}\" src=\"data:image/png;base64,{data}\"><figcaption>{name}</figcaption></figure>\n"
    )
}

/// What the colours mean.
fn scale(gallery: &Gallery) -> String {
    let stops = (0..=8).map(|i| {
        let [r, g, b] = tsdfuse_eval::color::of_distance(f64::from(i), 8.0);
        format!("rgb({r} {g} {b})")
    });
    let stops = stops.collect::<Vec<_>>().join(", ");
    let most = 100.0 * gallery.max_error_m;
    format!(
        "<div class=\"scale\">0 <span style=\"background: linear-gradient(90deg, {stops})\"></span> {most} cm and more</div>\n"
    )
}
