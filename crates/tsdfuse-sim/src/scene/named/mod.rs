//! The named scenes.

mod hall;
mod street;
mod targets;

use rand::SeedableRng;

use crate::objects::Rng;
use crate::scene::solids::Scene;

const NAMES: [&str; 5] = ["street", "hall", "plane", "sphere", "box"];

/// The names of the scenes that [`by_name`] knows.
pub fn names() -> &'static [&'static str] {
    &NAMES
}

/// A scene by its name, varied by the seed; `None` for a name that is not in [`names`].
///
/// | name | what |
/// |---|---|
/// | `street` | 120 m of sloping road between houses with recessed windows, doors and cornices; kerbs, parked cars, lamps, signs, trees, fences, stairs |
/// | `hall` | 30 m × 20 m × 8 m indoors: pillars, beams, loaded racks, a mezzanine with stairs, pipes, machines, barrels; open windows and gates |
/// | `plane` | the ground z = 0, 100 m square |
/// | `sphere` | radius 2 m about the origin |
/// | `box` | 3 m × 2 m × 1.5 m about the origin, turned about all axes |
pub fn by_name(name: &str, seed: u64) -> Option<Scene> {
    let mut rng = Rng::seed_from_u64(seed);
    let solids = match name {
        "street" => street::street(&mut rng)?,
        "hall" => hall::hall(&mut rng),
        "plane" => targets::plane(),
        "sphere" => targets::sphere(),
        "box" => targets::cuboid(),
        _ => return None,
    };
    Some(Scene::new(name, solids))
}

#[cfg(test)]
mod tests;
