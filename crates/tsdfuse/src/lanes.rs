//! Sixteen returns side by side, in loops that the compiler turns into vector instructions.

use glam::Vec3;

/// How many returns are worked on together.
pub(crate) const LANES: usize = 16;

/// One number per return.
pub(crate) type Floats = [f32; LANES];

/// One truth value per return.
pub(crate) type Mask = [bool; LANES];

/// One vector per return.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Vectors {
    pub(crate) x: Floats,
    pub(crate) y: Floats,
    pub(crate) z: Floats,
}

/// Applies a function lane by lane. A plain loop: `array::from_fn` is not inlined into code with other vector instructions.
#[inline(always)]
pub(crate) fn lanes<T: Copy + Default>(mut f: impl FnMut(usize) -> T) -> [T; LANES] {
    let mut all = [T::default(); LANES];
    for (lane, value) in all.iter_mut().enumerate() {
        *value = f(lane);
    }
    all
}

impl Vectors {
    pub(crate) const ZERO: Self = Self {
        x: [0.0; LANES],
        y: [0.0; LANES],
        z: [0.0; LANES],
    };

    #[inline(always)]
    pub(crate) fn set(&mut self, lane: usize, v: Vec3) {
        (self.x[lane], self.y[lane], self.z[lane]) = (v.x, v.y, v.z);
    }

    #[inline(always)]
    pub(crate) fn get(&self, lane: usize) -> Vec3 {
        Vec3::new(self.x[lane], self.y[lane], self.z[lane])
    }

    #[inline(always)]
    pub(crate) fn add(self, b: Self) -> Self {
        Self {
            x: lanes(|l| self.x[l] + b.x[l]),
            y: lanes(|l| self.y[l] + b.y[l]),
            z: lanes(|l| self.z[l] + b.z[l]),
        }
    }

    #[inline(always)]
    pub(crate) fn scale(self, s: Floats) -> Self {
        Self {
            x: lanes(|l| self.x[l] * s[l]),
            y: lanes(|l| self.y[l] * s[l]),
            z: lanes(|l| self.z[l] * s[l]),
        }
    }

    #[inline(always)]
    pub(crate) fn dot(self, b: Self) -> Floats {
        lanes(|l| self.x[l] * b.x[l] + self.y[l] * b.y[l] + self.z[l] * b.z[l])
    }

    #[inline(always)]
    pub(crate) fn cross(self, b: Self) -> Self {
        Self {
            x: lanes(|l| self.y[l] * b.z[l] - self.z[l] * b.y[l]),
            y: lanes(|l| self.z[l] * b.x[l] - self.x[l] * b.z[l]),
            z: lanes(|l| self.x[l] * b.y[l] - self.y[l] * b.x[l]),
        }
    }

    /// 1/length; infinite or NaN for vectors without direction.
    #[inline(always)]
    pub(crate) fn inverse_length(self) -> Floats {
        let squared = self.dot(self);
        lanes(|l| 1.0 / squared[l].sqrt())
    }

    /// Where the mask is set; zero elsewhere.
    #[inline(always)]
    pub(crate) fn select(self, mask: Mask) -> Self {
        Self {
            x: select(mask, self.x),
            y: select(mask, self.y),
            z: select(mask, self.z),
        }
    }
}

/// The numbers where the mask is set; zero elsewhere.
#[inline(always)]
pub(crate) fn select(mask: Mask, numbers: Floats) -> Floats {
    lanes(|l| if mask[l] { numbers[l] } else { 0.0 })
}
