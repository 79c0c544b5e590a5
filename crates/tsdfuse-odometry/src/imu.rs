//! What an inertial measurement unit predicts of the sensor's motion, and what registration tells about the unit: its biases, gravity, and
//! whether its samples can be believed at all.
//!
//! Nothing is believed without proof. Each sweep is predicted in three ways: by the motion before, with turns from the gyroscope, and with
//! velocities from the accelerometer, too. The one that was nearest to the registered motion lately is used. So a unit with wrong units, a wrong
//! mounting or a wrong clock does no harm; the first two are found out and corrected.

use std::collections::VecDeque;

use glam::{DMat3, DQuat, DVec3};
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
use serde::{Deserialize, Serialize};
use tsdfuse::trajectory::secs_between;
use tsdfuse::{ImuSample, Pose, STANDARD_GRAVITY as GRAVITY};

use crate::motion::{Motion, STEPS, turn_of};

/// A time without samples that is longer than this is not bridged, seconds.
const LONGEST_GAP: f64 = 0.1;

/// Standard deviation of a gyroscope's bias before anything is known, rad/s, and how much it changes in a second.
const GYRO_BIAS: (f64, f64) = (0.01, 1e-4);

/// The same of an accelerometer, m/s².
const FORCE_BIAS: (f64, f64) = (0.2, 1e-3);

/// Standard deviation of gravity's components before the sensor has moved, m/s²: its acceleration at the start.
const FIRST_GRAVITY: f64 = 1.0;

/// Standard deviation of a registered turn between sweeps, radians, and of a velocity, m/s.
const REGISTERED: (f64, f64) = (0.001, 0.05);

/// How far a prediction may lag behind another one that is simpler, and still be used, metres.
const EVEN: f64 = 0.002;

/// A turn of one radian is as wrong as a shift of so many metres.
const ARM_M: f64 = 5.0;

/// Turns, squared and summed up, that tell about the gyroscope, rad².
const TOLD: f64 = 0.02;

/// Most of the turns' squares that may be left where gyroscope and registration agree.
const LEFT: f64 = 0.1;

/// A unit that is turned by less than this against the LiDAR, radians, is where the log says it is.
const TURNED: f64 = 0.15;

/// How a sweep is predicted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PredictedBy {
    /// The motion before goes on.
    #[default]
    Motion,
    /// Turns are the gyroscope's, and the velocity is the one before.
    Gyroscope,
    /// Turns are the gyroscope's, and the velocity follows the accelerometer.
    Imu,
}

/// What was found out about the inertial measurement unit.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ImuReport {
    /// Samples that came.
    pub samples: usize,
    /// Sweeps that were predicted by turns alone, and by all of it.
    pub predicted: [usize; 2],
    /// Bias of the rates of turn, rad/s, in the sensor frame.
    pub gyroscope_bias: [f64; 3],
    /// Bias of the specific force, m/s², in the sensor frame.
    pub accelerometer_bias: [f64; 3],
    /// What is wrong with the samples, and what was done about it.
    pub notes: Vec<String>,
}

/// A sample in seconds on the scans' clock.
#[derive(Clone, Copy, Debug)]
struct Sample {
    secs: f64,
    rate: DVec3,
    force: DVec3,
}

/// What becomes of the velocity while the gyroscope tells turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Velocity {
    /// It stays as it is in the world.
    Kept,
    /// It stays as it is in the frame of the sensor, as that of a vehicle does.
    Ahead,
    /// It follows the accelerometer.
    Forced,
}

/// A sweep as it is predicted, with the velocity at its end, m/s in the world.
#[derive(Clone, Debug)]
pub(crate) struct Prediction {
    pub(crate) motion: Motion,
    pub(crate) velocity: DVec3,
}

impl Prediction {
    /// How far the end is off, metres (turns as shifts at [`ARM_M`]).
    fn error(&self, end: &Pose) -> f64 {
        let off = self.motion.last().inverse() * *end;
        off.translation.length() + ARM_M * turn_of(off.rotation).length()
    }
}

/// The end of a sweep.
#[derive(Clone, Copy, Debug)]
pub(crate) struct End {
    pub(crate) secs: f64,
    pub(crate) pose: Pose,
    /// In the world, m/s.
    pub(crate) velocity: DVec3,
}

/// The unit's samples, and what is known about it. All is in the sensor frame, and in the tracker's world.
#[derive(Clone, Debug)]
pub(crate) struct Inertial {
    samples: VecDeque<Sample>,
    /// Bias of the rates, and its variance along each axis.
    gyro_bias: (DVec3, f64),
    /// Gravity in the world and bias of the force, with their covariance.
    gravity: Option<(Vector6<f64>, Matrix6<f64>)>,
    /// How far predictions were off lately: of the motion before, by turns, by all.
    errors: [f64; 3],
    /// What rates and forces are multiplied by.
    corrections: (DMat3, DMat3),
    checks: Checks,
    report: ImuReport,
}

/// Whether samples are what they should be.
#[derive(Clone, Debug)]
struct Checks {
    /// Σ r gᵀ, Σ r rᵀ and Σ gᵀg of the turns of sweeps: r registered, g by the gyroscope.
    mixed: DMat3,
    registered: DMat3,
    measured: f64,
    is_turn_told: bool,
    is_force_told: bool,
    is_disagreement_told: bool,
}

fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

fn matrix(m: DMat3) -> Matrix3<f64> {
    Matrix3::from_column_slice(&m.to_cols_array())
}

fn dvec(v: &Vector3<f64>) -> DVec3 {
    DVec3::new(v.x, v.y, v.z)
}

impl Inertial {
    pub(crate) fn new() -> Self {
        Self {
            samples: VecDeque::new(),
            gyro_bias: (DVec3::ZERO, GYRO_BIAS.0.powi(2)),
            gravity: None,
            errors: [0.0; 3],
            corrections: (DMat3::IDENTITY, DMat3::IDENTITY),
            // The default of a matrix is the identity.
            checks: Checks {
                mixed: DMat3::ZERO,
                registered: DMat3::ZERO,
                measured: 0.0,
                is_turn_told: false,
                is_force_told: false,
                is_disagreement_told: false,
            },
            report: ImuReport::default(),
        }
    }

    /// Takes samples in the sensor frame, in the order of their times; those that are not later than the ones before are left out.
    pub(crate) fn push(&mut self, samples: impl IntoIterator<Item = ImuSample>) {
        let (by_rate, by_force) = self.corrections;
        for sample in samples {
            let new = Sample {
                secs: secs_between(0, sample.time_ns),
                rate: by_rate * sample.angular_velocity,
                force: by_force * sample.acceleration,
            };
            let is_later = self.samples.back().is_none_or(|last| last.secs < new.secs);
            if is_later && new.rate.is_finite() && new.force.is_finite() {
                self.samples.push_back(new);
                self.report.samples += 1;
            }
        }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.report.samples == 0
    }

    pub(crate) fn report(&self) -> ImuReport {
        let force = self
            .gravity
            .as_ref()
            .map_or([0.0; 3], |(state, _)| [state[3], state[4], state[5]]);
        ImuReport {
            gyroscope_bias: self.gyro_bias.0.to_array(),
            accelerometer_bias: force,
            ..self.report.clone()
        }
    }

    /// Mean rate and force over a time, as measured (linear between samples); `None` if there are not samples all along.
    fn mean(&self, from: f64, to: f64) -> Option<(DVec3, DVec3)> {
        let after = self.samples.partition_point(|sample| sample.secs <= from);
        let before = after.checked_sub(1)?;
        let at = |i: usize, secs: f64| {
            let (a, b) = (self.samples.get(i)?, self.samples.get(i + 1)?);
            let share = (secs - a.secs) / (b.secs - a.secs);
            (b.secs - a.secs <= LONGEST_GAP).then(|| (a.rate.lerp(b.rate, share), a.force.lerp(b.force, share)))
        };
        let (mut rate, mut force) = (DVec3::ZERO, DVec3::ZERO);
        let (mut i, mut secs) = (before, from);
        let mut here = at(i, secs)?;
        if to <= from {
            return Some(here);
        }
        while secs < to {
            let next = self.samples.get(i + 1)?.secs.min(to);
            let there = at(i, next)?;
            let half = 0.5 * (next - secs);
            rate += half * (here.0 + there.0);
            force += half * (here.1 + there.1);
            (secs, here) = (next, there);
            i += 1;
        }
        Some((rate / (to - from), force / (to - from)))
    }

    /// Gravity in the world, m/s², if it is known.
    fn gravity(&self) -> Option<DVec3> {
        let (state, _) = self.gravity.as_ref()?;
        Some(DVec3::new(state[0], state[1], state[2]))
    }

    /// Upwards in the world, of length 1.
    pub(crate) fn up(&self) -> Option<DVec3> {
        Some((-self.gravity()?).normalize())
    }

    /// After the world was turned.
    pub(crate) fn turn_world(&mut self, turn: DQuat) {
        if let Some((state, covariance)) = &mut self.gravity {
            let mut all = Matrix6::identity();
            all.fixed_view_mut::<3, 3>(0, 0)
                .copy_from(&matrix(DMat3::from_quat(turn)));
            *state = all * *state;
            *covariance = all * *covariance * all.transpose();
        }
    }

    /// From a moment on: poses at even steps until `to`, and the velocity there.
    fn integrate(&self, from: &End, to: f64, steps: usize, course: Velocity) -> Option<(Vec<Pose>, DVec3)> {
        let step = (to - from.secs) / steps as f64;
        let mut here = *from;
        let mut poses = vec![here.pose];
        let ahead = from.pose.rotation.conjugate() * from.velocity;
        let (gravity, bias) = match (&self.gravity, course) {
            (Some((state, _)), Velocity::Forced) => (
                DVec3::new(state[0], state[1], state[2]),
                DVec3::new(state[3], state[4], state[5]),
            ),
            (None, Velocity::Forced) => return None,
            _ => (DVec3::ZERO, DVec3::ZERO),
        };
        for _ in 0..steps {
            let (rate, force) = self.mean(here.secs, here.secs + step)?;
            let turn = (rate - self.gyro_bias.0) * step;
            let middle = here.pose.rotation * DQuat::from_scaled_axis(0.5 * turn);
            let acceleration = if course == Velocity::Forced {
                middle * (force - bias) + gravity
            } else {
                DVec3::ZERO
            };
            here.pose = Pose {
                rotation: (here.pose.rotation * DQuat::from_scaled_axis(turn)).normalize(),
                translation: here.pose.translation + step * (here.velocity + 0.5 * step * acceleration),
            };
            here.velocity = match course {
                Velocity::Ahead => here.pose.rotation * ahead,
                Velocity::Kept | Velocity::Forced => here.velocity + step * acceleration,
            };
            here.secs += step;
            poses.push(here.pose);
        }
        Some((poses, here.velocity))
    }

    /// A sweep that begins `gap` seconds after the end of the last one and takes `secs`.
    pub(crate) fn predict(&self, last: &End, gap: f64, secs: f64, course: Velocity) -> Option<Prediction> {
        let begin = last.secs + gap;
        let (pose, velocity) = if gap > 0.0 {
            let (poses, velocity) = self.integrate(last, begin, (gap / 0.01).ceil() as usize, course)?;
            (*poses.last()?, velocity)
        } else {
            (last.pose, last.velocity)
        };
        let from = End {
            secs: begin,
            pose,
            velocity,
        };
        if secs <= 0.0 {
            return Some(Prediction {
                motion: Motion::still(pose),
                velocity,
            });
        }
        let (poses, velocity) = self.integrate(&from, begin + secs, STEPS, course)?;
        Some(Prediction {
            motion: Motion { poses: poses.into() },
            velocity,
        })
    }

    /// Which of the three predictions (by the motion before, by turns, by all) is to be used.
    pub(crate) fn choose(&self, predicted: [Option<&Prediction>; 3]) -> PredictedBy {
        let ways = [PredictedBy::Motion, PredictedBy::Gyroscope, PredictedBy::Imu];
        let known = || (0..3).filter(|&way| predicted[way].is_some());
        let least = known().map(|way| self.errors[way]).fold(f64::INFINITY, f64::min);
        let best = known().rev().find(|&way| self.errors[way] <= 1.2 * least + EVEN);
        best.map_or(PredictedBy::Motion, |way| ways[way])
    }

    /// Learns from a sweep that was registered: `last` is the end of the one before, `used` how it was predicted.
    pub(crate) fn learn(
        &mut self,
        last: &End,
        end: &End,
        secs: f64,
        predicted: [Option<&Prediction>; 3],
        used: PredictedBy,
        is_position_known: bool,
    ) {
        for (error, predicted) in self.errors.iter_mut().zip(predicted) {
            // What cannot be predicted is no better than the worst.
            let new = predicted.map_or(*error, |predicted| predicted.error(&end.pose));
            let share = if new > *error { 0.5 } else { 0.2 };
            *error += share * (new - *error);
        }
        match used {
            PredictedBy::Motion => {}
            PredictedBy::Gyroscope => self.report.predicted[0] += 1,
            PredictedBy::Imu => self.report.predicted[1] += 1,
        }
        self.check_turns(last, end);
        if let Some(predicted) = predicted[1] {
            self.learn_turn(&predicted.motion.last(), end, end.secs - last.secs);
        }
        self.check_force(end.secs - secs, end.secs);
        match &self.gravity {
            None => self.begin_gravity(end, secs),
            Some(_) if is_position_known => self.learn_force(last, end, predicted[2]),
            Some(_) => {}
        }
    }

    /// Forgets samples that nothing after this moment is predicted from.
    pub(crate) fn forget(&mut self, secs: f64) {
        let old = self.samples.partition_point(|sample| sample.secs < secs - 1.0);
        self.samples.drain(..old);
    }

    /// The gyroscope's bias, from how far a turn was off.
    fn learn_turn(&mut self, predicted: &Pose, end: &End, secs: f64) {
        let off = turn_of(predicted.rotation.conjugate() * end.pose.rotation);
        if !(secs > 0.0) || off.length() > 0.02 {
            return;
        }
        let (bias, variance) = &mut self.gyro_bias;
        *variance += GYRO_BIAS.1.powi(2) * secs;
        let total = *variance * secs * secs + REGISTERED.0.powi(2);
        let gain = *variance * secs / total;
        *bias -= gain * off;
        *variance *= 1.0 - gain * secs;
    }

    /// Gravity, as the force over the last sweep says if the sensor does not accelerate.
    fn begin_gravity(&mut self, end: &End, secs: f64) {
        let Some((_, force)) = self.mean(end.secs - secs.max(0.05), end.secs) else {
            return;
        };
        if force.length() < 0.5 * GRAVITY || force.length() > 1.5 * GRAVITY {
            return;
        }
        let down = -(end.pose.rotation * force).normalize() * GRAVITY;
        let state = Vector6::new(down.x, down.y, down.z, 0.0, 0.0, 0.0);
        let (gravity, bias) = (FIRST_GRAVITY.powi(2), FORCE_BIAS.0.powi(2));
        let covariance = Matrix6::from_diagonal(&Vector6::new(gravity, gravity, gravity, bias, bias, bias));
        self.gravity = Some((state, covariance));
    }

    /// Gravity and the accelerometer's bias, from how far the velocity was off (a Kalman filter).
    fn learn_force(&mut self, last: &End, end: &End, predicted: Option<&Prediction>) {
        let secs = end.secs - last.secs;
        let (Some(predicted), Some((state, covariance))) = (predicted, &mut self.gravity) else {
            return;
        };
        let off = end.velocity - predicted.velocity;
        if !(secs > 0.0) || off.length() > 1.0 {
            return;
        }
        for axis in 3..6 {
            covariance[(axis, axis)] += FORCE_BIAS.1.powi(2) * secs;
        }
        // off = secs · (error of gravity − R · error of the bias)
        let turn = matrix(DMat3::from_quat(end.pose.rotation));
        let mut h = nalgebra::Matrix3x6::zeros();
        h.fixed_view_mut::<3, 3>(0, 0).fill_diagonal(secs);
        h.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-secs * turn));
        let noise = Matrix3::from_diagonal_element(2.0 * REGISTERED.1.powi(2));
        let total = h * *covariance * h.transpose() + noise;
        let Some(inverse) = total.try_inverse() else { return };
        let gain = *covariance * h.transpose() * inverse;
        *state += gain * Vector3::new(off.x, off.y, off.z);
        *covariance -= gain * h * *covariance;
        // Gravity is known to be so strong.
        let gravity = state.fixed_rows::<3>(0).into_owned();
        let length = gravity.norm();
        let mut h = nalgebra::RowVector6::zeros();
        h.fixed_columns_mut::<3>(0).copy_from(&(gravity / length).transpose());
        let total = (h * *covariance * h.transpose())[0] + 0.02_f64.powi(2);
        let gain = *covariance * h.transpose() / total;
        *state += gain * (GRAVITY - length);
        *covariance -= gain * h * *covariance;
        *covariance = 0.5 * (*covariance + covariance.transpose());
    }

    /// Whether the gyroscope turns as registration says: in degrees, or about other axes?
    fn check_turns(&mut self, last: &End, end: &End) {
        let checks = &self.checks;
        if checks.is_turn_told {
            return;
        }
        let Some((rate, _)) = self.mean(last.secs, end.secs) else {
            return;
        };
        let measured = rate * (end.secs - last.secs);
        let registered = turn_of(last.pose.rotation.conjugate() * end.pose.rotation);
        let checks = &mut self.checks;
        checks.mixed += outer(registered, measured);
        checks.registered += outer(registered, registered);
        checks.measured += measured.length_squared();
        let told = trace(&checks.registered);
        if told < TOLD || checks.measured <= 0.0 {
            return;
        }
        let scale = trace(&checks.mixed) / checks.measured;
        let left = 1.0 - scale * trace(&checks.mixed) / told;
        if left < LEFT && (0.8..1.25).contains(&scale) {
            checks.is_turn_told = true;
            return;
        }
        let per_degree = 1.0_f64.to_radians();
        if left < LEFT && (0.8..1.25).contains(&(scale / per_degree)) {
            checks.is_turn_told = true;
            self.note("the IMU's rates of turn are in degrees a second, not in radians: converted".to_owned());
            return self.correct(DMat3::from_diagonal(DVec3::splat(per_degree)), DMat3::IDENTITY);
        }
        // About other axes: turns about two of them must have been seen.
        let eigen = tsdfuse::eigen::eigen(&checks.registered);
        if eigen.values[1] < TOLD {
            return;
        }
        let (turn, left) = aligned(&checks.mixed, told, checks.measured);
        if left < LEFT {
            checks.is_turn_told = true;
            let (axis, angle) = turn.to_axis_angle();
            if angle < TURNED {
                return;
            }
            self.note(format!(
                "the IMU is turned against the LiDAR by {:.0}° about ({:.2}, {:.2}, {:.2}), which the log does not say: its samples were turned back",
                angle.to_degrees(),
                axis.x,
                axis.y,
                axis.z
            ));
            let turn = DMat3::from_quat(turn);
            self.correct(turn, turn);
        } else if told > 50.0 * TOLD && !checks.is_disagreement_told {
            checks.is_disagreement_told = true;
            self.note("the IMU does not turn as the LiDAR does (another clock?): it is not used".to_owned());
        }
    }

    /// Whether the force is in m/s² or in g.
    fn check_force(&mut self, from: f64, to: f64) {
        if self.checks.is_force_told {
            return;
        }
        let Some((_, force)) = self.mean(from, to) else {
            return;
        };
        self.checks.is_force_told = true;
        let length = force.length();
        if (0.5..1.5).contains(&length) {
            self.note("the IMU's accelerations are in g, not in m/s²: converted".to_owned());
            self.correct(DMat3::IDENTITY, DMat3::from_diagonal(DVec3::splat(GRAVITY)));
        } else if !(0.5 * GRAVITY..1.5 * GRAVITY).contains(&length) {
            self.note(format!(
                "the IMU's accelerations are {length:.2} at the start, which is gravity neither in m/s² nor in g: they are not used"
            ));
        }
    }

    fn note(&mut self, note: String) {
        self.report.notes.push(note);
    }

    /// Corrects all samples, those to come included, and begins to learn anew.
    fn correct(&mut self, rate: DMat3, force: DMat3) {
        for sample in &mut self.samples {
            sample.rate = rate * sample.rate;
            sample.force = force * sample.force;
        }
        self.corrections = (rate * self.corrections.0, force * self.corrections.1);
        self.gyro_bias = (DVec3::ZERO, GYRO_BIAS.0.powi(2));
        self.gravity = None;
        self.errors[1..].fill(0.0);
    }
}

fn trace(m: &DMat3) -> f64 {
    m.x_axis.x + m.y_axis.y + m.z_axis.z
}

/// The rotation R that brings measured turns nearest to registered ones, `mixed` being Σ r gᵀ (Kabsch, 1976), and which share of the squares
/// is left.
fn aligned(mixed: &DMat3, registered: f64, measured: f64) -> (DQuat, f64) {
    let svd = matrix(*mixed).svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return (DQuat::IDENTITY, 1.0);
    };
    let sign = (u * v_t).determinant().signum();
    let turn = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t;
    let column = |c: usize| dvec(&turn.column(c).into_owned());
    let rotation = DMat3::from_cols(column(0), column(1), column(2));
    let agreed = trace(&(rotation.transpose() * *mixed));
    let left = (registered - 2.0 * agreed + measured) / registered;
    (DQuat::from_mat3(&rotation).normalize(), left)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sensor that swings like one in a hand: at a time, in seconds.
    fn pose(t: f64) -> Pose {
        let turn = DVec3::new(
            0.2 * (2.1 * t).sin(),
            0.15 * (2.9 * t).cos(),
            0.8 * (0.9 * t).sin() + 0.3 * t,
        );
        Pose {
            rotation: DQuat::from_euler(glam::EulerRot::ZYX, turn.z, turn.y, turn.x),
            translation: DVec3::new(1.2 * t, 0.3 * (2.3 * t).sin(), 0.05 * (6.0 * t).sin()),
        }
    }

    fn velocity(t: f64) -> DVec3 {
        let h = 1e-5;
        (pose(t + h).translation - pose(t - h).translation) / (2.0 * h)
    }

    fn end(t: f64) -> End {
        End {
            secs: t,
            pose: pose(t),
            velocity: velocity(t),
        }
    }

    const BIASES: (DVec3, DVec3) = (DVec3::new(0.004, -0.006, 0.003), DVec3::new(0.05, -0.08, 0.06));

    /// What a unit measures every 5 ms, in the sensor frame.
    fn samples(secs: f64) -> Vec<ImuSample> {
        let sample = |i: usize| {
            let (t, h) = (0.005 * i as f64, 1e-4);
            let turned = pose(t - h).rotation.conjugate() * pose(t + h).rotation;
            let acceleration = (velocity(t + h) - velocity(t - h)) / (2.0 * h);
            ImuSample {
                time_ns: 5_000_000 * i as i64,
                angular_velocity: turn_of(turned) / (2.0 * h) + BIASES.0,
                acceleration: pose(t).rotation.conjugate() * (acceleration + DVec3::Z * GRAVITY) + BIASES.1,
                orientation: None,
            }
        };
        (0..(secs / 0.005) as usize).map(sample).collect()
    }

    /// The motion that would be predicted without a unit.
    fn steady(last: &End, secs: f64) -> Prediction {
        let turned = pose(last.secs - secs).inverse() * last.pose;
        Prediction {
            motion: Motion::steady(last.pose, &turned),
            velocity: last.velocity,
        }
    }

    #[test]
    fn the_first_sweep_is_bent_as_the_gyroscope_says() {
        let mut imu = Inertial::new();
        imu.push(samples(2.0));
        let (from, gap, secs) = (end(0.4), 0.05, 0.1);
        let motion = imu.predict(&from, gap, secs, Velocity::Ahead).unwrap().motion;
        let worst = |motion: &Motion| {
            let at = |j: usize| pose(from.secs + gap + secs * j as f64 / STEPS as f64);
            let off = |(j, own): (usize, &Pose)| own.rotation.angle_between(at(j).rotation);
            motion.poses.iter().enumerate().map(off).fold(0.0, f64::max)
        };
        assert_eq!(motion.poses.len(), STEPS + 1);
        // What is left is the unknown bias, for 0.15 s.
        assert!(worst(&motion) < 1.2 * 0.15 * BIASES.0.length(), "{}", worst(&motion));
        assert!(motion.last().translation.distance(pose(0.55).translation) < 0.05);
        // No samples are left there.
        assert!(imu.predict(&end(1.95), gap, secs, Velocity::Ahead).is_none());
    }

    /// Learns from ten sweeps a second, placed exactly; says how far the ways predicted the last ones, and which one is chosen.
    fn learnt(samples: Vec<ImuSample>, secs: f64) -> (Inertial, [f64; 3], PredictedBy) {
        let mut imu = Inertial::new();
        imu.push(samples);
        let mut used = PredictedBy::Motion;
        for sweep in 1..(10.0 * secs) as usize {
            let (last, now) = (end(0.1 * sweep as f64), end(0.1 * (sweep + 1) as f64));
            let (turned, forced) = (
                imu.predict(&last, 0.0, 0.1, Velocity::Kept),
                imu.predict(&last, 0.0, 0.1, Velocity::Forced),
            );
            let steady = steady(&last, 0.1);
            let predicted = [Some(&steady), turned.as_ref(), forced.as_ref()];
            used = imu.choose(predicted);
            imu.learn(&last, &now, 0.1, predicted, used, true);
        }
        let errors = imu.errors;
        (imu, errors, used)
    }

    #[test]
    fn biases_and_gravity_are_learnt_and_sweeps_predicted_to_a_millimetre() {
        let (imu, [steady, turned, forced], used) = learnt(samples(31.0), 30.0);
        assert_eq!(used, PredictedBy::Imu);
        assert!(
            steady > 0.05 && turned < 0.03 && forced < 0.003,
            "{steady} {turned} {forced}"
        );
        let report = imu.report();
        let (gyro, force) = (report.gyroscope_bias.into(), report.accelerometer_bias.into());
        assert!(BIASES.0.distance(gyro) < 5e-4, "{gyro}");
        assert!(BIASES.1.distance(force) < 0.03, "{force}");
        assert!(imu.up().unwrap().distance(DVec3::Z) < 0.003, "{:?}", imu.up());
        assert!(report.notes.is_empty() && report.predicted[1] > 250, "{report:?}");
    }

    #[test]
    fn poses_within_a_sweep_follow_the_unit() {
        let (imu, ..) = learnt(samples(31.0), 30.0);
        let predicted = imu.predict(&end(30.0), 0.1, 0.1, Velocity::Forced).unwrap();
        for (j, got) in predicted.motion.poses.iter().enumerate() {
            let want = pose(30.1 + 0.1 * j as f64 / STEPS as f64);
            assert!(want.translation.distance(got.translation) < 0.003);
            assert!(turn_of(want.rotation.conjugate() * got.rotation).length() < 0.001);
        }
        assert!(predicted.velocity.distance(velocity(30.2)) < 0.02);
    }

    #[test]
    fn wrong_units_are_found_out_and_corrected() {
        let mut wrong = samples(16.0);
        for sample in &mut wrong {
            sample.angular_velocity = sample.angular_velocity.map(f64::to_degrees);
            sample.acceleration /= GRAVITY;
        }
        let (imu, [.., forced], used) = learnt(wrong, 15.0);
        let notes = imu.report().notes;
        assert!(notes.iter().any(|note| note.contains("in degrees")), "{notes:?}");
        assert!(notes.iter().any(|note| note.contains("in g, ")), "{notes:?}");
        assert!(used == PredictedBy::Imu && forced < 0.01, "{used:?} {forced}");
    }

    #[test]
    fn a_unit_that_is_mounted_otherwise_is_turned_back() {
        let mounted = DQuat::from_euler(glam::EulerRot::ZYX, 2.0, 0.3, -1.2);
        let mut turned = samples(16.0);
        for sample in &mut turned {
            sample.angular_velocity = mounted * sample.angular_velocity;
            sample.acceleration = mounted * sample.acceleration;
        }
        let (imu, [.., forced], used) = learnt(turned, 15.0);
        let notes = imu.report().notes;
        assert!(
            notes.len() == 1 && notes[0].contains("turned against the LiDAR"),
            "{notes:?}"
        );
        assert!(used == PredictedBy::Imu && forced < 0.01, "{used:?} {forced}");
    }

    #[test]
    fn a_unit_on_another_clock_is_not_used() {
        let mut late = samples(31.0);
        late.rotate_left(200);
        for (i, sample) in late.iter_mut().enumerate() {
            sample.time_ns = 5_000_000 * i as i64;
        }
        let (imu, _, used) = learnt(late, 25.0);
        assert_eq!(used, PredictedBy::Motion);
        let notes = imu.report().notes;
        assert!(notes.len() == 1 && notes[0].contains("it is not used"), "{notes:?}");
    }

    #[test]
    fn without_samples_all_along_nothing_is_predicted() {
        let mut gapped = samples(2.0);
        gapped.retain(|sample| !(500_000_000..700_000_000).contains(&sample.time_ns));
        let mut imu = Inertial::new();
        imu.push(gapped.iter().copied().chain(gapped.iter().copied()));
        assert_eq!(imu.report().samples, gapped.len());
        assert!(imu.predict(&end(0.2), 0.0, 0.1, Velocity::Kept).is_some());
        assert!(imu.predict(&end(0.45), 0.0, 0.1, Velocity::Kept).is_none());
        assert!(imu.predict(&end(1.95), 0.0, 0.1, Velocity::Kept).is_none());
        assert!(
            imu.predict(&end(0.2), 0.0, 0.1, Velocity::Forced).is_none(),
            "gravity is not known yet"
        );
    }
}
