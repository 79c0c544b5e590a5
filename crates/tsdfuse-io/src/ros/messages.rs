//! Messages other than points: what stamps, poses, frames, IMUs, GNSS receivers and cameras say.

use tsdfuse::glam::{DQuat, DVec3};
use tsdfuse::sensor::Pinhole;
use tsdfuse::{ImuSample, Pose};

use super::value::Value;
use crate::source::GnssFix;

/// What a message's header says.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Header {
    pub(crate) stamp_ns: i64,
    pub(crate) frame: String,
}

/// The stamp in a struct with seconds and nanoseconds.
pub(crate) fn stamp(value: &Value<'_>, path: &str) -> Result<i64, String> {
    let part = |name: &str| value.int(&format!("{path}.{name}"));
    let (sec, nanosec) = (part("sec")?, part("nanosec")?);
    Ok(sec.saturating_mul(1_000_000_000).saturating_add(nanosec))
}

/// The header that a message begins with.
pub(crate) fn header(message: &Value<'_>) -> Result<Header, String> {
    Ok(Header {
        stamp_ns: stamp(message, "header.stamp")?,
        frame: message.text("header.frame_id")?,
    })
}

fn vector(value: &Value<'_>, path: &str) -> Result<DVec3, String> {
    let part = |name: &str| value.float(&format!("{path}.{name}"));
    Ok(DVec3::new(part("x")?, part("y")?, part("z")?))
}

fn quaternion(value: &Value<'_>, path: &str) -> Result<DQuat, String> {
    let part = |name: &str| value.float(&format!("{path}.{name}"));
    Ok(DQuat::from_xyzw(part("x")?, part("y")?, part("z")?, part("w")?))
}

fn pose(value: &Value<'_>, position: &str, orientation: &str) -> Result<Pose, String> {
    let pose = Pose::new(quaternion(value, orientation)?, vector(value, position)?);
    pose.map_err(|e| format!("{position}: {e}"))
}

/// A pose with the frames it connects.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Placed {
    pub(crate) time_ns: i64,
    pub(crate) parent: String,
    /// Empty where it is not told.
    pub(crate) child: String,
    pub(crate) pose: Pose,
}

/// The transforms of a `tf2_msgs/TFMessage`.
pub(crate) fn transforms(message: &Value<'_>) -> Result<Vec<Placed>, String> {
    message.list("transforms")?.iter().map(transform).collect()
}

/// A `geometry_msgs/TransformStamped`.
pub(crate) fn transform(message: &Value<'_>) -> Result<Placed, String> {
    let Header { stamp_ns, frame } = header(message)?;
    Ok(Placed {
        time_ns: stamp_ns,
        parent: frame,
        child: message.text("child_frame_id")?,
        pose: pose(message, "transform.translation", "transform.rotation")?,
    })
}

/// A `nav_msgs/Odometry`, `geometry_msgs/PoseStamped` or `PoseWithCovarianceStamped`.
pub(crate) fn stamped_pose(message: &Value<'_>) -> Result<Placed, String> {
    let Header { stamp_ns, frame } = header(message)?;
    let (position, orientation) = match message.get("pose.pose") {
        Ok(_) => ("pose.pose.position", "pose.pose.orientation"),
        Err(_) => ("pose.position", "pose.orientation"),
    };
    Ok(Placed {
        time_ns: stamp_ns,
        parent: frame,
        child: message.text("child_frame_id").unwrap_or_default(),
        pose: pose(message, position, orientation)?,
    })
}

/// The poses of a `nav_msgs/Path`.
pub(crate) fn path(message: &Value<'_>) -> Result<Vec<Placed>, String> {
    message.list("poses")?.iter().map(stamped_pose).collect()
}

/// A `sensor_msgs/Imu` in its own frame.
pub(crate) fn imu(message: &Value<'_>) -> Result<ImuSample, String> {
    // By the definition, −1 says that there is no orientation.
    let covariance = message.numbers("orientation_covariance")?.iter().next();
    let orientation = quaternion(message, "orientation")?;
    let is_told = covariance != Some(-1.0) && orientation.is_finite() && (orientation.length() - 1.0).abs() < 0.01;
    Ok(ImuSample {
        time_ns: header(message)?.stamp_ns,
        angular_velocity: vector(message, "angular_velocity")?,
        acceleration: vector(message, "linear_acceleration")?,
        orientation: is_told.then(|| orientation.normalize()),
    })
}

/// A `sensor_msgs/NavSatFix`, without its time; `None` if it has no fix.
pub(crate) fn fix(message: &Value<'_>) -> Result<Option<GnssFix>, String> {
    let (latitude_deg, longitude_deg) = (message.float("latitude")?, message.float("longitude")?);
    // By the definition, NaN says that there is none.
    let altitude_m = Some(message.float("altitude")?).filter(|altitude| altitude.is_finite());
    let is_fix = message.int("status.status")? >= 0 && latitude_deg.is_finite() && longitude_deg.is_finite();
    let covariance: Vec<f64> = message.numbers("position_covariance")?.iter().collect();
    let sigma_m = match covariance.as_slice() {
        // Of an unknown covariance the type is 0.
        &[east, _, _, _, north, _, _, _, up] if message.int("position_covariance_type")? > 0 => {
            let sigmas = [east, north, up].map(f64::sqrt);
            sigmas
                .iter()
                .all(|sigma| sigma.is_finite() && *sigma > 0.0)
                .then_some(sigmas)
        }
        _ => None,
    };
    Ok(is_fix.then_some(GnssFix {
        latitude_deg,
        longitude_deg,
        altitude_m,
        sigma_m,
        ..GnssFix::default()
    }))
}

/// A `sensor_msgs/CameraInfo`: the camera, and OpenCV's five coefficients where that is the model.
pub(crate) fn camera(message: &Value<'_>) -> Result<(Pinhole, Option<[f64; 5]>), String> {
    let size = |name: &str| u32::try_from(message.int(name)?).map_err(|_| format!("{name} is negative"));
    let k: Vec<f64> = message.numbers("k")?.iter().collect();
    let &[fx, _, cx, _, fy, cy, ..] = k.as_slice() else {
        return Err("k has no 9 numbers".to_owned());
    };
    let [fx, fy, cx, cy] = [fx, fy, cx, cy].map(|v| v as f32);
    let camera = Pinhole {
        width: size("width")?,
        height: size("height")?,
        fx,
        fy,
        cx,
        cy,
    };
    camera.check().map_err(|e| e.to_string())?;
    let d: Vec<f64> = message.numbers("d")?.iter().take(5).collect();
    let model = message.text("distortion_model").unwrap_or_default();
    let is_plain = d.iter().any(|v| *v != 0.0) && !matches!(model.as_str(), "equidistant" | "fisheye");
    let mut coefficients = [0.0; 5];
    coefficients.iter_mut().zip(&d).for_each(|(to, from)| *to = *from);
    Ok((camera, is_plain.then_some(coefficients)))
}
