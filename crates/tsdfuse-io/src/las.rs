//! LAS and LAZ: points of the world with GPS times, and a trajectory that tells where the scanner was.
//!
//! Poses with times (TUM, a table, …) lie beside, or are named; they are on the clock of the points' GPS times. Points of each
//! tenth of a second become a scan: each is brought back to where the scanner saw it. (Clouds in the scanner's own frame, one file a
//! scan, are read as other [clouds](crate::clouds) are.) A file is gone through once for its times; a scan is read when it is asked for.

use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::files;
use crate::poses::{self, Poses};
use crate::source::OpenOptions;

/// Whether a file begins as LAS does.
fn is_las(path: &Path) -> bool {
    use std::io::Read;
    let mut head = [0; 4];
    let read = std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut head));
    read.is_ok() && &head == b"LASF"
}

/// The files: the one that is named, or those of a folder.
fn paths(path: &Path) -> Result<Vec<PathBuf>> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()].into_iter().filter(|path| is_las(path)).collect());
    }
    let all = [files::list(path, "las")?, files::list(path, "laz")?].concat();
    Ok(all
        .into_iter()
        .map(|file| file.path)
        .filter(|path| is_las(path))
        .collect())
}

/// A trajectory for them, that is named or lies beside.
fn trajectory(path: &Path, options: &OpenOptions) -> Result<Option<(PathBuf, tsdfuse::Trajectory)>> {
    let folder = if path.is_dir() { Some(path) } else { path.parent() };
    let folder = folder
        .filter(|folder| !folder.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    let file = match &options.poses {
        Some(file) => Some(file.clone()),
        None => poses::find(folder)?,
    };
    let Some(file) = file else { return Ok(None) };
    match poses::read(&file)? {
        Poses::Timed(trajectory) => Ok(Some((file, trajectory))),
        Poses::Listed(_) => Ok(None),
    }
}

/// Whether it is a file of LAS, or a folder of such files with a trajectory.
pub(crate) fn recognises(path: &Path) -> bool {
    path.is_file() && is_las(path)
        || path.is_dir()
            && paths(path).is_ok_and(|paths| !paths.is_empty())
            && trajectory(path, &OpenOptions::default()).is_ok_and(|found| found.is_some())
}

#[cfg(not(feature = "las"))]
pub(crate) fn open(path: &Path, _: &OpenOptions) -> Result<crate::listed::Listed> {
    Err(Error::dataset(path, NOT_BUILT))
}

#[cfg(not(feature = "las"))]
pub(crate) fn parse(path: &Path, _: &[u8]) -> Result<crate::Cloud> {
    Err(Error::format(path, NOT_BUILT))
}

#[cfg(not(feature = "las"))]
const NOT_BUILT: &str = "is LAS, which is read if tsdfuse is built with --features las";

#[cfg(feature = "las")]
pub(crate) use reading::{open, parse};

#[cfg(feature = "las")]
mod reading {
    use std::collections::BTreeMap;
    use std::io::{Read, Seek, SeekFrom};
    use std::sync::Arc;

    use las::{PointData, Reader};
    use tsdfuse::glam::{DVec3, Vec3};
    use tsdfuse::trajectory::{ns_after, secs_between};
    use tsdfuse::{Pose, Scan, Trajectory};

    use super::*;
    use crate::cloud::Cloud;
    use crate::listed::Listed;
    use crate::placed;
    use crate::source::{ScanRef, Sensor};

    /// How long a scan is.
    const SWEEP_NS: i64 = 100_000_000;
    /// No scanner sees this far, metres.
    const FAR_M: f64 = 10_000.0;
    /// Points that are unpacked at once.
    const BATCH: u64 = 1 << 16;

    /// Points of one scan, and others, in a file.
    #[derive(Clone, Copy)]
    struct Piece {
        file: usize,
        first: u64,
        end: u64,
    }

    pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<Listed> {
        let files = paths(path)?;
        let Some((pose_file, trajectory)) = trajectory(path, options)? else {
            let reason = "does not tell where the scanner was: a trajectory (TUM or a table with a header) beside it, or --poses FILE, \
                          supplies it, on the clock of the points' GPS times";
            return Err(Error::dataset(path, reason));
        };
        check_world(&files, &pose_file, &trajectory)?;
        let mut pieces: BTreeMap<i64, Vec<Piece>> = BTreeMap::new();
        for (number, file) in files.iter().enumerate() {
            index(file, number, &mut pieces)?;
        }
        let body_from_sensor = options.extrinsics.unwrap_or_default();
        let (mut scans, mut places, mut unplaced) = (Vec::new(), Vec::new(), 0);
        for (sweep, pieces) in pieces {
            let Some(time_ns) = sweep.checked_mul(SWEEP_NS) else {
                continue;
            };
            // The trajectory may begin within the sweep.
            let middle = trajectory
                .at(time_ns)
                .or_else(|| trajectory.at(time_ns.saturating_add(SWEEP_NS / 2)));
            let Some(pose) = middle else {
                unplaced += 1;
                continue;
            };
            scans.push(ScanRef {
                name: format!("{:.1} s", secs_between(0, time_ns)),
                sensor: 0,
                time_ns: Some(time_ns),
                pose: Some(pose * body_from_sensor),
            });
            places.push(pieces);
        }
        if scans.is_empty() {
            let (first, last) = trajectory.span_ns();
            let reason = format!(
                "has poses from {:.3} to {:.3} s, and no point was measured then",
                secs_between(0, first),
                secs_between(0, last)
            );
            return Err(Error::dataset(pose_file, reason));
        }
        let mut notes = Vec::new();
        if unplaced > 0 {
            notes.push(format!(
                "{unplaced} tenths of a second with points but without a pose are left out"
            ));
        }
        let along = Along {
            files,
            trajectory: Arc::new(trajectory.clone()),
            body_from_sensor,
        };
        let refs = scans.clone();
        Ok(Listed {
            format: "LAS",
            sensors: vec![Sensor {
                body_from_sensor,
                ..Sensor::new("lidar")
            }],
            scans,
            trajectory: Some(trajectory),
            images: Vec::new(),
            notes,
            read: Box::new(move |index| along.read(&refs, index, &places[index])),
        })
    }

    /// Refuses a trajectory that is far from all points: it lies in another world.
    fn check_world(files: &[PathBuf], pose_file: &Path, trajectory: &Trajectory) -> Result<()> {
        let mut nearest = f64::INFINITY;
        for file in files {
            let las::Bounds { min, max } = reader(file)?.header().bounds();
            let (low, high) = (DVec3::new(min.x, min.y, min.z), DVec3::new(max.x, max.y, max.z));
            for pose in trajectory.poses() {
                let place = pose.translation;
                nearest = nearest.min(place.distance(place.max(low).min(high)));
            }
        }
        if nearest.is_finite() && nearest > FAR_M {
            let reason = format!(
                "is {:.0} km from the points: both must lie in one world (of latitudes and longitudes, the first is the origin, and of a \
                 projection such as UTM, another place)",
                nearest * 1e-3
            );
            return Err(Error::dataset(pose_file, reason));
        }
        Ok(())
    }

    fn wrong(path: &Path) -> impl Fn(las::Error) -> Error {
        move |reason| {
            Error::format(
                path,
                reason.to_string().split_whitespace().collect::<Vec<_>>().join(" "),
            )
        }
    }

    fn reader(path: &Path) -> Result<Reader> {
        let file = std::fs::File::open(path).map_err(Error::io(path))?;
        checked_reader(path, std::io::BufReader::new(file))
    }

    /// A reader of what does not claim more chunks than it has bytes.
    fn checked_reader(path: &Path, mut input: impl Read + Seek + Send + Sync + 'static) -> Result<Reader> {
        let claimed = claimed_chunks(&mut input).map_err(|_| Error::format(path, "is truncated"))?;
        if let Some((chunks, bytes)) = claimed.filter(|(chunks, bytes)| chunks > bytes) {
            let reason = format!("claims {chunks} chunks of points in {bytes} bytes");
            return Err(Error::format(path, reason));
        }
        Reader::new(input).map_err(wrong(path))
    }

    /// The number of chunks that LAZ tells, and the bytes of the file; `None` if it is not compressed. Goes back to the begin.
    fn claimed_chunks(input: &mut (impl Read + Seek)) -> std::io::Result<Option<(u64, u64)>> {
        let bytes = input.seek(SeekFrom::End(0))?;
        input.seek(SeekFrom::Start(0))?;
        let mut head = [0; 105];
        input.read_exact(&mut head)?;
        let is_compressed = head[104] & 0xC0 != 0;
        let mut chunks = None;
        if is_compressed {
            let mut number = [0; 8];
            let points = u32::from_le_bytes([head[96], head[97], head[98], head[99]]);
            input.seek(SeekFrom::Start(points.into()))?;
            input.read_exact(&mut number)?;
            let mut table = i64::from_le_bytes(number);
            if table <= 0 {
                // A writer that could not go back told it at the end.
                input.seek(SeekFrom::End(-8))?;
                input.read_exact(&mut number)?;
                table = i64::from_le_bytes(number);
            }
            if let Ok(table) = u64::try_from(table) {
                input.seek(SeekFrom::Start(table))?;
                // Its version, and how many there are.
                input.read_exact(&mut number)?;
                chunks = Some((
                    u32::from_le_bytes([number[4], number[5], number[6], number[7]]).into(),
                    bytes,
                ));
            }
        }
        input.seek(SeekFrom::Start(0))?;
        Ok(chunks)
    }

    /// The next points; `None` at the end.
    fn batch(path: &Path, reader: &mut Reader, most: u64) -> Result<Option<PointData>> {
        let points = reader.read_points(most.min(BATCH)).map_err(wrong(path))?;
        Ok(Some(points).filter(|points| !points.is_empty()))
    }

    fn sweep_of(secs: f64) -> Option<i64> {
        let ns = secs * 1e9;
        (ns.abs() < 9e18).then(|| (ns as i64).div_euclid(SWEEP_NS))
    }

    /// Notes where the points of each scan are.
    fn index(path: &Path, file: usize, pieces: &mut BTreeMap<i64, Vec<Piece>>) -> Result<()> {
        let mut reader = reader(path)?;
        let mut at = 0;
        while let Some(points) = batch(path, &mut reader, BATCH)? {
            let times = points.gps_time();
            let times = times.ok_or_else(|| {
                Error::format(
                    path,
                    "has points without GPS times, so where each was seen from is not known",
                )
            })?;
            for secs in times {
                if let Some(sweep) = sweep_of(secs) {
                    let all = pieces.entry(sweep).or_default();
                    match all.last_mut().filter(|piece| piece.file == file) {
                        Some(piece) => piece.end = at + 1,
                        None => all.push(Piece {
                            file,
                            first: at,
                            end: at + 1,
                        }),
                    }
                }
                at += 1;
            }
        }
        Ok(())
    }

    /// What brings points of the world back to the scanner.
    struct Along {
        files: Vec<PathBuf>,
        trajectory: Arc<Trajectory>,
        body_from_sensor: Pose,
    }

    impl Along {
        fn read(&self, scans: &[ScanRef], index: usize, pieces: &[Piece]) -> Result<Scan> {
            let begin_ns = scans[index].time_ns.unwrap_or_default();
            let mut scan = Scan::default();
            let (mut times, mut intensities) = (Vec::new(), Vec::new());
            for piece in pieces {
                let path = &self.files[piece.file];
                let mut reader = reader(path)?;
                reader.seek(piece.first).map_err(wrong(path))?;
                let mut left = piece.end - piece.first;
                while left > 0 {
                    let Some(points) = batch(path, &mut reader, left)? else {
                        break;
                    };
                    left = left.saturating_sub(points.len() as u64);
                    let places = points.x().zip(points.y()).zip(points.z());
                    let rows = places
                        .zip(points.intensity())
                        .zip(points.gps_time().into_iter().flatten());
                    for ((((x, y), z), intensity), secs) in rows {
                        if sweep_of(secs) != Some(begin_ns.div_euclid(SWEEP_NS)) {
                            continue;
                        }
                        let time_ns = ns_after(0, secs);
                        let Some(world_from_body) = self.trajectory.at(time_ns) else {
                            scan.dropped.untimed += 1;
                            continue;
                        };
                        let sensor_from_world = (world_from_body * self.body_from_sensor).inverse();
                        scan.points
                            .push(sensor_from_world.transform_point(DVec3::new(x, y, z)).as_vec3());
                        times.push(secs_between(begin_ns, time_ns) as f32);
                        intensities.push(f32::from(intensity));
                    }
                }
            }
            scan.motion = placed::motion(scans, index, &times, Some(&self.trajectory), &self.body_from_sensor);
            (scan.times, scan.intensities) = (Some(times), Some(intensities));
            Ok(scan)
        }
    }

    /// Parses a file as a cloud in the scanner's frame; `path` is for messages.
    ///
    /// # Errors
    /// Names the file and what is wrong.
    pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<Cloud> {
        read(path, std::io::Cursor::new(bytes.to_vec()))
    }

    fn read(path: &Path, input: impl Read + Seek + Send + Sync + 'static) -> Result<Cloud> {
        let mut reader = checked_reader(path, input)?;
        let (mut points, mut intensities) = (Vec::new(), Vec::new());
        while let Some(some) = batch(path, &mut reader, BATCH)? {
            let places = some.x().zip(some.y()).zip(some.z());
            points.extend(places.map(|((x, y), z)| Vec3::new(x as f32, y as f32, z as f32)));
            intensities.extend(some.intensity().map(f32::from));
        }
        Ok(Cloud {
            points,
            intensities: Some(intensities),
            ..Cloud::default()
        })
    }
}
