//! The arguments of `tsdfuse evaluate`.

use std::path::PathBuf;

use clap::builder::PossibleValuesParser;
use glam::DVec3;
use tsdfuse::MapConfig;
use tsdfuse_eval::Protocol;

use super::forms::Form;
use crate::config::DEPTH_CAMERA_TRUNCATION_M;
use crate::exit::Usage;
use crate::settings::Settings;
use crate::simulate::parse_triple;

const EXAMPLES: &str = "\
What is compared: a mesh of all scans with the reference; and a map without every K-th scan with the returns of those \
(hits, false surface, missing surface). The reference is --reference, or the true surface of a simulated data set, or the \
points of all scans. Each method runs in a process of its own. What each figure means: docs/evaluation.md.

Examples:
  tsdfuse evaluate pandaset/002 -o pandaset-002
  tsdfuse evaluate street --methods raycast,raycast-projective --runs 3 -o street-methods
  tsdfuse evaluate kitti/sequences/00 --scans 0..200 --method-set raycast:map.voxel_size_m=0.1,map.truncation_m=0.3
  tsdfuse evaluate kitti/sequences/00 --tune --budget 600";

/// Compare methods on a data set: error, completeness, held-out scans, speed and memory, as tables and a report with pictures.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    #[arg(long, value_name = "NAMES", value_delimiter = ',',
        help = format!("Which methods: all, or some of {} [default: all, or none with --method-set]", Form::names().join(", ")))]
    pub(super) methods: Vec<String>,
    /// A method with settings of its own: METHOD:KEY=VALUE[,KEY=VALUE].
    #[arg(long, value_name = "SET")]
    pub(super) method_set: Vec<String>,
    /// The folder for report.html, table.md, results.json and methods.png.
    #[arg(short, long, value_name = "DIR")]
    pub(super) output: Option<PathBuf>,
    /// Print the results as JSON on standard output instead of tables.
    #[arg(long)]
    pub(super) json: bool,
    /// Every K-th scan is held out; 0: none [default: 10, or fewer where there are fewer scans].
    #[arg(long, value_name = "K")]
    pub(super) hold_out: Option<u32>,
    #[arg(long, value_name = "M", help = format!(
        "Farther from its return than this, surface is another surface [default: {}, or {DEPTH_CAMERA_TRUNCATION_M} for depth cameras]",
        MapConfig::default().truncation_m))]
    pub(super) margin: Option<f64>,
    /// What meshes are compared with: a mesh or a cloud (.ply), or a data set for the points of its scans.
    #[arg(long, value_name = "FILE")]
    pub(super) reference: Option<PathBuf>,
    /// Where points of scans are the reference: only each N-th scan.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) every: u32,
    /// How meshes are compared [default: surface with a mesh, thesis with points as the reference].
    #[arg(long, value_name = "NAME", value_parser = PossibleValuesParser::new(Protocol::NAMES))]
    pub(super) protocol: Option<String>,
    /// Samples on each mesh [default: the protocol's].
    #[arg(long, value_name = "N")]
    pub(super) samples: Option<usize>,
    /// Runs of each method, for the range of its speed.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub(super) runs: u32,
    /// A picture's place and what is in its middle, world, metres; more than one may be given [default: from above and twice from
    /// the sensor].
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", value_parser = parse_view, allow_hyphen_values = true)]
    pub(super) view: Vec<[DVec3; 2]>,
    /// The error at the bright end of the colours, metres.
    #[arg(long, value_name = "M", default_value_t = 0.05)]
    pub(super) max_error: f64,
    /// Keep the meshes, as PLY, in the folder of the results.
    #[arg(long, requires = "output")]
    pub(super) keep_meshes: bool,
    /// Search method, voxel size and truncation by held-out error instead, and print the command to use.
    #[arg(long)]
    pub(super) tune: bool,
    /// How long the search may take, seconds.
    #[arg(long, value_name = "SECS", default_value_t = 300.0, requires = "tune")]
    pub(super) budget: f64,
    #[command(flatten)]
    pub(super) settings: Settings,
}

impl Args {
    /// The margin of held-out returns, metres.
    pub(super) fn margin_m(&self, is_camera: bool) -> Result<f64, Usage> {
        let default = match is_camera {
            true => DEPTH_CAMERA_TRUNCATION_M,
            false => MapConfig::default().truncation_m,
        };
        let margin_m = self.margin.unwrap_or(default);
        for (flag, value) in [("--margin", margin_m), ("--max-error", self.max_error)] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Usage::new(format_args!(
                    "{flag} must be a positive length in metres, not {value}"
                )));
            }
        }
        Ok(margin_m)
    }
}

fn parse_view(text: &str) -> Result<[DVec3; 2], String> {
    let wanted = || "six numbers are wanted: the camera's x,y,z and those of what it looks at".to_owned();
    let third_comma = text.match_indices(',').nth(2).ok_or_else(wanted)?.0;
    let [from, to] = [&text[..third_comma], &text[third_comma + 1..]].map(parse_triple);
    let view = [from.map_err(|_| wanted())?, to.map_err(|_| wanted())?];
    match view[0] == view[1] {
        true => Err("the camera is where it looks at".to_owned()),
        false => Ok(view),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_is_two_places() {
        assert_eq!(
            parse_view("1,2,3,-4,5.5,6"),
            Ok([DVec3::new(1.0, 2.0, 3.0), DVec3::new(-4.0, 5.5, 6.0)])
        );
        for bad in [
            "",
            "1,2,3",
            "1,2,3,4,5",
            "1,2,3,4,5,x",
            "1,2,3,4,5,6,7",
            "1,2,3,1,2,3",
            "1,2,3,4,5,nan",
        ] {
            assert!(parse_view(bad).is_err(), "{bad}");
        }
    }
}
