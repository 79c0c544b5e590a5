//! The trajectory of a saved map: the poses of the scans that were fused.

use std::io::{self, Error, ErrorKind, Read};

use tsdfuse::Pose;
use tsdfuse::glam::{DQuat, DVec3};

use super::format::{CHANGED, POSES_HEADER, POSES_MARK, Wrong, array, checksum, wrong};

/// Bytes of a pose: time, position, quaternion.
const POSE: usize = 64;
/// Stands for a time that is not known.
const NO_TIME: i64 = i64::MIN;

/// Where a scan was fused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FusedPose {
    /// When it was taken, nanoseconds since its log's epoch; −2⁶³ is taken for unknown.
    pub time_ns: Option<i64>,
    /// `world_from_sensor`.
    pub pose: Pose,
}

/// The poses as bytes, with checksums, as a map file has them.
///
/// # Errors
/// `InvalidInput` for 2³² poses or more.
pub fn pack_poses(poses: &[FusedPose]) -> io::Result<Vec<u8>> {
    let count = u32::try_from(poses.len()).map_err(|e| Error::new(ErrorKind::InvalidInput, e))?;
    let mut body = Vec::with_capacity(poses.len() * POSE);
    for FusedPose { time_ns, pose } in poses {
        body.extend(time_ns.unwrap_or(NO_TIME).to_le_bytes());
        let (t, q) = (pose.translation, pose.rotation);
        for number in [t.x, t.y, t.z, q.x, q.y, q.z, q.w] {
            body.extend(number.to_le_bytes());
        }
    }
    let mut bytes = Vec::with_capacity(POSES_HEADER + 4 + body.len());
    bytes.extend(POSES_MARK);
    bytes.extend(count.to_le_bytes());
    bytes.extend(checksum(&[&body]).to_le_bytes());
    bytes.extend(checksum(&[&bytes]).to_le_bytes());
    bytes.extend(body);
    Ok(bytes)
}

/// The poses of such bytes.
///
/// # Errors
/// `InvalidData` says what is wrong with them.
pub fn unpack_poses(mut bytes: &[u8]) -> io::Result<Vec<FusedPose>> {
    let poses = read_poses(&mut bytes).map_err(|e| match e {
        Wrong::System(e) => Error::new(ErrorKind::InvalidData, e),
        Wrong::Reason(reason) => Error::new(ErrorKind::InvalidData, reason),
    })?;
    if !bytes.is_empty() {
        return Err(Error::new(ErrorKind::InvalidData, "bytes follow the last pose"));
    }
    Ok(poses)
}

/// Reads the poses and leaves what follows them.
pub(super) fn read_poses(bytes: &mut impl Read) -> Result<Vec<FusedPose>, Wrong> {
    let fields: [u8; POSES_HEADER] = array(bytes)?;
    if !fields.starts_with(&POSES_MARK) || u32::from_le_bytes(array(bytes)?) != checksum(&[&fields]) {
        return wrong(CHANGED);
    }
    let mut fields = &fields[POSES_MARK.len()..];
    let count = u32::from_le_bytes(array(&mut fields)?) as usize;
    let expected = u32::from_le_bytes(array(&mut fields)?);
    // Grows with what is there, whatever the count says.
    let mut body = Vec::new();
    bytes.take((count * POSE) as u64).read_to_end(&mut body)?;
    if body.len() < count * POSE {
        return Err(io::Error::from(ErrorKind::UnexpectedEof).into());
    }
    if checksum(&[&body]) != expected {
        return wrong(CHANGED);
    }
    let poses = (0..).zip(body.chunks_exact(POSE));
    poses.map(|(number, bytes)| pose_of(number, bytes)).collect()
}

/// Parses pose number `number`.
fn pose_of(number: u32, mut bytes: &[u8]) -> Result<FusedPose, Wrong> {
    let time_ns = i64::from_le_bytes(array(&mut bytes)?);
    let mut field = || array(&mut bytes).map(f64::from_le_bytes);
    let translation = DVec3::new(field()?, field()?, field()?);
    let rotation = DQuat::from_xyzw(field()?, field()?, field()?, field()?);
    if let Err(reason) = Pose::new(rotation, translation) {
        return wrong(format!("pose {number}: {reason}"));
    }
    Ok(FusedPose {
        time_ns: (time_ns != NO_TIME).then_some(time_ns),
        // As it was written: normalising could change a bit.
        pose: Pose { rotation, translation },
    })
}
