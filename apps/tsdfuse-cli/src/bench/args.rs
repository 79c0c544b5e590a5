//! The arguments of `tsdfuse bench`.

use std::path::Path;

use anyhow::Result;

use super::method::Method;
use super::street;
use crate::config::{Layers, Suggested};
use crate::device::Device;
use crate::evaluate::forms::Form;
use crate::exit::Usage;
use crate::fuse::Memory;
use crate::settings::Settings;

const EXAMPLES: &str = "\
A run is what `tsdfuse fuse` does, from files to a mesh in a temporary file. Threads that fuse and threads that read ahead share \
the cores. Beside each method stands what memory allows on as many threads, measured just before.

Examples:
  tsdfuse bench
  tsdfuse bench pandaset/002 --methods raycast,raycast-projective,normals
  tsdfuse bench --threads 1 --json
  tsdfuse bench --long-drive 10000
  tsdfuse bench --long-drive 16000 --memory 512M
  tsdfuse bench --device gpu --methods raycast,patch";

/// Measure this machine: seconds of each stage, and how close to the memory's limit.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES, mut_arg("dataset", |dataset| dataset.required(false).default_value(street::NAME)
    .hide_default_value(true).help(format!("The data set [default: {}, the same everywhere]", street::NAME))))]
pub(crate) struct Args {
    #[arg(long, visible_alias = "method", value_name = "NAMES", value_delimiter = ',',
        help = format!("Which methods: all, or some of {} [default: as with fuse]", Form::names().join(", ")))]
    pub(super) methods: Vec<String>,
    /// Runs of each method.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub(super) runs: u32,
    /// Print the results as JSON instead of tables.
    #[arg(long)]
    pub(super) json: bool,
    /// Drive on and on through a simulated street instead, N scans of a VLP-16, and tell whether a scan takes longer as the map
    /// grows. Voxels are of 12.5 cm unless --voxel-size or --set says otherwise.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(20..=1_000_000))]
    pub(super) long_drive: Option<u32>,
    /// Drive with no more blocks of the map in memory than this; then extract the surface of all of it, and tell how much file it takes.
    #[arg(long, value_name = "SIZE", requires = "long_drive")]
    pub(super) memory: Option<Memory>,
    /// What is measured; of a GPU, fusing, meshing, rendering and each kernel.
    #[arg(long, value_name = "cpu|gpu|gpu:NAME", default_value = "cpu")]
    pub(super) device: Device,
    #[command(flatten)]
    pub(super) settings: Settings,
}

impl Args {
    /// Finds out before the work what cannot be.
    pub(super) fn check(&self) -> Result<()> {
        let forms = self.forms()?;
        forms.iter().try_for_each(|form| self.layers(Some(form)).map(drop))?;
        self.layers(None)?;
        if self.long_drive.is_some() {
            if self.device != Device::Cpu {
                return Err(Usage::new("--long-drive is for the CPU").into());
            }
            if forms.len() > 1 {
                return Err(Usage::new("--long-drive is for one method").into());
            }
            if !self.is_simulated() || self.settings.scans.is_some() {
                return Err(
                    Usage::new("--long-drive simulates its own scans: no data set and no --scans with it").into(),
                );
            }
        }
        Ok(())
    }

    /// Whether no data set is named.
    pub(super) fn is_simulated(&self) -> bool {
        self.settings.dataset == Path::new(street::NAME)
    }

    /// The methods with all their settings.
    pub(super) fn methods(&self, data: &Suggested) -> Result<Vec<Method>> {
        let forms = self.forms()?;
        if forms.is_empty() {
            let config = self.layers(None)?.resolve(data)?;
            return Ok(vec![Method::new(config.method.name().to_owned(), config)]);
        }
        let method = |form: Form| {
            let config = self.layers(Some(&form))?.resolve(data)?;
            Ok(Method::new(form.name, config))
        };
        forms.into_iter().map(method).collect()
    }

    /// The methods that are asked for by name.
    fn forms(&self) -> Result<Vec<Form>, Usage> {
        if self.methods.is_empty() {
            return Ok(Vec::new());
        }
        Form::chosen(&self.methods, &[])
    }

    fn layers(&self, form: Option<&Form>) -> Result<Layers> {
        let mut layers = self.settings.layers(form.map(|form| form.method.name()))?;
        let settings = form.iter().flat_map(|form| &form.settings);
        settings.into_iter().try_for_each(|setting| layers.set_text(setting))?;
        if self.long_drive.is_some() {
            street::coarse(&mut layers)?;
        }
        Ok(layers)
    }
}
