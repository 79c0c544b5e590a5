//! Movies of several views, by ffmpeg.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Instant;

use tsdfuse::Pose;
use tsdfuse::render::{Camera, Pixels};
use tsdfuse::sensor::Pinhole;
use tsdfuse_io::Error;

use crate::error::{Result, RunError};
use crate::report::ViewReport;
use crate::view::Look;

/// Views in a second of a movie.
pub const FRAMES_PER_SEC: u32 = 25;

/// Whether a path asks for a movie: `.mp4`.
pub fn is_movie(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("mp4"))
}

/// A movie that is being made. It takes its name when it is complete.
#[derive(Debug)]
pub struct Movie {
    ffmpeg: Child,
    path: PathBuf,
    unfinished: PathBuf,
}

impl Movie {
    /// Starts ffmpeg, for frames of this camera.
    ///
    /// # Errors
    /// [`RunError::Config`] if there is no ffmpeg; [`RunError::Io`] if it does not start.
    pub fn begin(path: &Path, camera: &Pinhole) -> Result<Self> {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let unfinished = path.with_file_name(format!(".{name}.{}.mp4", std::process::id()));
        let mut command = Command::new("ffmpeg");
        command.args(["-v", "error", "-y", "-f", "rawvideo", "-pixel_format", "rgb24"]);
        command.args(["-video_size", &format!("{}x{}", camera.width, camera.height)]);
        command.args(["-framerate", &FRAMES_PER_SEC.to_string(), "-i", "-"]);
        // Even numbers of pixels, and colours that every player knows.
        command.args([
            "-vf",
            "pad=ceil(iw/2)*2:ceil(ih/2)*2",
            "-pix_fmt",
            "yuv420p",
            "-movflags",
            "+faststart",
        ]);
        command
            .arg(&unfinished)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        let ffmpeg = match command.spawn() {
            Ok(ffmpeg) => ffmpeg,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                let told = "movies are made by ffmpeg, which is not installed; with .png instead of .mp4 the views are written one by one";
                return Err(RunError::config(told));
            }
            Err(error) => return Err(Error::io("ffmpeg")(error).into()),
        };
        Ok(Self {
            ffmpeg,
            path: path.to_owned(),
            unfinished,
        })
    }

    /// Looks once, and adds what is seen.
    ///
    /// # Errors
    /// What looking and ffmpeg say.
    pub fn add(&mut self, look: &mut Look<'_>, camera: &Camera, pose: Pose) -> Result<ViewReport> {
        let start = Instant::now();
        let view = look(camera, pose)?;
        let seconds = start.elapsed().as_secs_f64();
        let image = view.shaded(camera, pose);
        if let (Pixels::Rgb(pixels), Some(stdin)) = (&image.pixels, &mut self.ffmpeg.stdin)
            && stdin.write_all(pixels.as_flattened()).is_err()
        {
            // It has ended, and tells why.
            self.end()?;
        }
        Ok(ViewReport {
            pose: pose.to_row_major_3x4(),
            width: view.width,
            height: view.height,
            surface_pixels: view.hit_count(),
            files: vec![self.path.clone()],
            seconds,
            write_seconds: start.elapsed().as_secs_f64() - seconds,
        })
    }

    /// Completes the file.
    ///
    /// # Errors
    /// What ffmpeg says, or if the file cannot be renamed.
    pub fn finish(mut self) -> Result<()> {
        self.end()?;
        Ok(std::fs::rename(&self.unfinished, &self.path).map_err(Error::io(&self.path))?)
    }

    fn end(&mut self) -> Result<()> {
        drop(self.ffmpeg.stdin.take());
        let mut told = String::new();
        if let Some(stderr) = &mut self.ffmpeg.stderr {
            std::io::Read::read_to_string(stderr, &mut told).map_err(Error::io("ffmpeg"))?;
        }
        let status = self.ffmpeg.wait().map_err(Error::io("ffmpeg"))?;
        if !status.success() {
            let told = told.lines().last().unwrap_or("it failed and said nothing");
            return Err(Error::dataset("ffmpeg", told).into());
        }
        Ok(())
    }
}

impl Drop for Movie {
    fn drop(&mut self) {
        drop(self.ffmpeg.stdin.take());
        let _ = self.ffmpeg.wait();
        // Of a complete one this name is gone.
        let _ = std::fs::remove_file(&self.unfinished);
    }
}
