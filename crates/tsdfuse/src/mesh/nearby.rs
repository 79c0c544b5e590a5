//! What is told at once, and what in turns.

use glam::{DVec3, IVec3};

/// So many turns let all places have theirs once.
const TURNS: i32 = 10;

/// The space around a robot: what changes there is wanted at once, what changes elsewhere at every tenth turn.
///
/// ```
/// use tsdfuse::mesh::Nearby;
/// use tsdfuse::glam::{DVec3, IVec3};
/// let mut nearby = Nearby::new(30.0);
/// let mut far = 0;
/// for scan in 0..20 {
///     nearby.move_to(DVec3::X * f64::from(scan)); // once a scan; then `changes_near` of an `Incremental`
///     assert!(nearby.is_due(IVec3::ZERO, 10.0));
///     far += u32::from(nearby.is_due(IVec3::X * 50, 10.0));
/// }
/// assert_eq!(far, 2);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearby {
    place: DVec3,
    near_m: f64,
    turn: i32,
}

impl Nearby {
    /// Up to so many metres around the origin.
    pub fn new(near_m: f64) -> Self {
        Self {
            place: DVec3::ZERO,
            near_m,
            turn: 0,
        }
    }

    /// The next turn, with the robot at a place in the world.
    pub fn move_to(&mut self, place: DVec3) {
        self.place = place;
        self.turn = (self.turn + 1) % TURNS;
    }

    /// Whether a cube of a grid whose cubes have such an edge is near, or has its turn. Cube 0 begins at the origin.
    pub fn is_due(&self, cube: IVec3, edge_m: f64) -> bool {
        let low = cube.as_dvec3() * edge_m;
        let nearest = self.place.clamp(low, low + edge_m);
        let IVec3 { x, y, z } = cube.rem_euclid(IVec3::splat(TURNS));
        nearest.distance(self.place) <= self.near_m || (x + 3 * y + 9 * z + self.turn) % TURNS == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_cubes_are_always_due_and_others_once_in_ten_turns() {
        let mut nearby = Nearby::new(5.0);
        let mut due = [0; 4];
        let cubes = [
            IVec3::new(50, 0, 0),
            IVec3::new(51, 2, 0),
            IVec3::new(54, 0, -1),
            IVec3::new(-54, 7, 3),
        ];
        for _ in 0..20 {
            nearby.move_to(DVec3::new(101.0, 1.0, 1.0));
            for (due, cube) in due.iter_mut().zip(cubes) {
                *due += i32::from(nearby.is_due(cube, 2.0));
            }
        }
        assert_eq!(due, [20, 20, 2, 2]);
        nearby.move_to(DVec3::NAN);
        assert!(!nearby.is_due(cubes[0], 2.0) || !nearby.is_due(cubes[1], 2.0));
    }
}
