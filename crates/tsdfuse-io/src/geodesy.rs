//! Positions on the earth in a local frame: metres east, north and up of an origin.

use std::f64::consts::FRAC_PI_2;

use tsdfuse::Pose;
use tsdfuse::glam::{DMat3, DQuat, DVec3};

/// WGS 84: the larger half axis, metres, and the flattening.
const AXIS_M: f64 = 6_378_137.0;
const FLATTENING: f64 = 1.0 / 298.257_223_563;

/// Latitude and longitude, degrees, and the height above the ellipsoid, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Geographic {
    pub(crate) latitude_deg: f64,
    pub(crate) longitude_deg: f64,
    pub(crate) height_m: f64,
}

impl Geographic {
    /// Where its axes east, north and up are in the frame that turns with the earth, whose origin is the earth's centre.
    fn earth_from_local(&self) -> Pose {
        let (sin_lat, cos_lat) = self.latitude_deg.to_radians().sin_cos();
        let (sin_lon, cos_lon) = self.longitude_deg.to_radians().sin_cos();
        let squared = FLATTENING * (2.0 - FLATTENING);
        let normal = AXIS_M / (1.0 - squared * sin_lat * sin_lat).sqrt();
        let out = (normal + self.height_m) * cos_lat;
        let east = DVec3::new(-sin_lon, cos_lon, 0.0);
        let north = DVec3::new(-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat);
        let up = DVec3::new(cos_lat * cos_lon, cos_lat * sin_lon, sin_lat);
        Pose {
            rotation: DQuat::from_mat3(&DMat3::from_cols(east, north, up)),
            translation: DVec3::new(
                out * cos_lon,
                out * sin_lon,
                (normal * (1.0 - squared) + self.height_m) * sin_lat,
            ),
        }
    }

    /// The pose of a body that is here and turned like this against east, north and up, in the frame east, north and up of the origin: of the
    /// first place, where there is none yet.
    ///
    /// # Errors
    /// If no place on the earth is there.
    pub(crate) fn body(self, rotation: DQuat, origin: &mut Option<Self>) -> Result<Pose, &'static str> {
        let [latitude, longitude, height] = [self.latitude_deg, self.longitude_deg, self.height_m].map(f64::abs);
        if !(latitude <= 90.0 && longitude <= 360.0 && height <= 1e5) {
            return Err("no place on the earth has this latitude, longitude and height");
        }
        let local = self.seen_from(origin.get_or_insert(self));
        Ok(Pose {
            rotation: local.rotation * rotation,
            translation: local.translation,
        })
    }

    /// The frame east, north, up at this place, in that of an origin. Away from the origin, up is another direction.
    pub(crate) fn seen_from(&self, origin: &Self) -> Pose {
        origin.earth_from_local().inverse() * self.earth_from_local()
    }
}

/// How a body (x forward, y left, z up) is turned against east, north and up: right side down, nose up, clockwise from north, radians.
pub(crate) fn attitude([roll, pitch, heading]: [f64; 3]) -> DQuat {
    DQuat::from_rotation_z(FRAC_PI_2 - heading) * DQuat::from_rotation_y(-pitch) * DQuat::from_rotation_x(roll)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_of_arc_is_known_in_metres() {
        let at = |latitude_deg, longitude_deg, height_m| Geographic {
            latitude_deg,
            longitude_deg,
            height_m,
        };
        let second = 1.0 / 3600.0;
        let seen = |place: Geographic, origin| place.seen_from(&origin).translation;
        // At the equator a degree of longitude is 111 319.49 m, one of latitude 110 574.3 m; at 60° 55 800.0 m and 111 412.2 m.
        for (latitude, east_m, north_m) in [(0.0, 111_319.491, 110_574.276), (60.0, 55_800.0, 111_412.2)] {
            let origin = at(latitude, 11.0, 300.0);
            let scale = 1.0 + 300.0 / AXIS_M;
            let east = seen(at(latitude, 11.0 + second, 300.0), origin);
            assert!((east.x - east_m * second * scale).abs() < 2e-3, "{east}");
            let north = seen(at(latitude + second, 11.0, 300.0), origin);
            assert!((north.y - north_m * second * scale).abs() < 2e-3, "{north}");
            let up = seen(at(latitude, 11.0, 310.0), origin);
            assert!(up.distance(DVec3::new(0.0, 0.0, 10.0)) < 1e-6, "{up}");
        }
        // Ten kilometres on, up leans by 0.09°.
        let turned = at(45.09, 0.0, 0.0).seen_from(&at(45.0, 0.0, 0.0)).rotation;
        assert!((turned.to_scaled_axis().length().to_degrees() - 0.09).abs() < 1e-6);
    }
}
