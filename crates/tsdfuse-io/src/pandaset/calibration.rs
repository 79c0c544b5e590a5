//! Where the two sensors sit on the vehicle, which the data set does not say.

use std::f64::consts::FRAC_PI_2;

use tsdfuse::glam::{DMat3, DQuat, DVec3};
use tsdfuse::{Pose, SensorModel};

/// The Pandar64 in the vehicle's frame (x right, y forward, z up), fitted from a static sweep of sequence 002: the one
/// transform for which its returns lie on the 64 nominal beams, to 0.004° in the median. The fit leaves rotation about the
/// sensor's axis open; it is zero here, so that y of the sensor is y of the vehicle.
const EGO_FROM_PANDAR64: ([[f64; 3]; 3], [f64; 3]) = (
    [
        [0.99999984188969, -4.415190871540776e-06, -0.0005623176157845967],
        [-4.415190871540776e-06, 0.9998767068988961, -0.01570257881766632],
        [0.0005623176157845967, 0.01570257881766632, 0.9998765487885861],
    ],
    [0.002527157491460815, 0.7808566718806385, 1.8566781904571126],
);

/// The azimuth that the Pandar64 itself counts from, seen from the frame above: half a turn and 1.82°.
///
/// Measured: in every frame the returns of all beams start at this azimuth, where the sensor's own angle is zero.
const PANDAR64_ZERO_AZIMUTH_DEG: f64 = 181.82;

/// The PandarGT in the Pandar64's own frame, as published: `front_gt` in PandaSet's `static_extrinsic_calibration.yaml`
/// (quaternion x, y, z, w and metres). So it looks ahead from 0.61 m in front of the Pandar64 and 0.30 m below.
///
/// Confirmed on frames 36 to 52 of sequence 002: seen from there the scan lines are smooth curves across all depths
/// (seen from the Pandar64 they jump by a degree at each edge), and the field of view is symmetric, ±31.3°. The origin
/// for which the lines are smoothest is 0.03 m away from the published one.
const PANDAR64_FROM_PANDARGT: ([f64; 4], [f64; 3]) = (
    [
        -0.002060907279494794,
        0.01134678181520767,
        0.9997028534282365,
        0.021475754959146356,
    ],
    [-0.000451117754, -0.605646431446, -0.301525235176],
);

/// One of the two sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Lidar {
    /// The rotating sensor on the roof.
    Pandar64,
    /// The solid-state sensor that looks ahead.
    PandarGt,
}

impl Lidar {
    /// The sensor of that name; case, hyphens, underscores and blanks do not matter.
    pub(super) fn named(name: &str) -> Option<Self> {
        let letters = name.chars().filter(|c| !matches!(c, '-' | '_' | ' '));
        match letters.map(|c| c.to_ascii_lowercase()).collect::<String>().as_str() {
            "pandar64" => Some(Self::Pandar64),
            "pandargt" => Some(Self::PandarGt),
            _ => None,
        }
    }

    /// Its name on the command line.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Pandar64 => "pandar64",
            Self::PandarGt => "pandargt",
        }
    }

    /// Its number in the column `d`.
    pub(super) fn device(self) -> f64 {
        match self {
            Self::Pandar64 => 0.0,
            Self::PandarGt => 1.0,
        }
    }

    /// Its beams; the PandarGT has a scanning mirror instead.
    pub(super) fn model(self) -> Option<SensorModel> {
        match self {
            Self::Pandar64 => tsdfuse::sensor::model("pandar64"),
            Self::PandarGt => None,
        }
    }

    /// Returns nearer than this, metres, are the vehicle.
    ///
    /// Measured on the Pandar64's returns of sequence 002: those from the vehicle lie between 0.55 m and 1.40 m, and there is
    /// none from there to 2.55 m, where what stands beside it begins.
    pub(super) fn min_range_m(self) -> Option<f32> {
        match self {
            Self::Pandar64 => Some(2.0),
            Self::PandarGt => None,
        }
    }

    /// `ego_from_sensor`: the vehicle's frame has y forward, the sensor's x forward.
    pub(super) fn ego_from_sensor(self) -> Pose {
        let ([x, y, z], origin) = EGO_FROM_PANDAR64;
        let rows = DMat3::from_cols_array_2d(&[x, y, z]);
        let ego_from_pandar64 = Pose {
            rotation: DQuat::from_mat3(&rows.transpose()),
            translation: DVec3::from(origin),
        };
        let y_forward_from_x_forward = turned(FRAC_PI_2);
        match self {
            Self::Pandar64 => ego_from_pandar64 * y_forward_from_x_forward,
            Self::PandarGt => {
                let (rotation, origin) = PANDAR64_FROM_PANDARGT;
                let published = Pose {
                    rotation: DQuat::from_array(rotation),
                    translation: DVec3::from(origin),
                };
                let own = turned(PANDAR64_ZERO_AZIMUTH_DEG.to_radians());
                ego_from_pandar64 * own * published * y_forward_from_x_forward
            }
        }
    }
}

/// A turn about z, to the left.
fn turned(angle_rad: f64) -> Pose {
    Pose {
        rotation: DQuat::from_rotation_z(angle_rad),
        translation: DVec3::ZERO,
    }
}
