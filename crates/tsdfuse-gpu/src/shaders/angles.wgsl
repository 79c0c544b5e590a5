// Angles from the polynomials of `tsdfuse::sensor::approx`, since built-in functions differ between devices.

const PI: f32 = 3.1415927;

// `atan(t) = t·P(t²)` for |t| ≤ 1.
const ATAN = array(
    1.0, -0.33333145, 0.19993551, -0.142089, 0.10656264, -0.07528964, 0.042909614, -0.016165737, 0.0028662257,
);

fn arc_tangent2(y: f32, x: f32) -> f32 {
    let a = abs(vec2(x, y));
    let t = min(a.x, a.y) / max(max(a.x, a.y), 1.1754944e-38);
    var sum = 0.0;
    for (var k = 8; k >= 0; k--) {
        sum = sum * (t * t) + ATAN[k];
    }
    let slope = t * sum;
    let angle = select(slope, 0.5 * PI - slope, a.y > a.x);
    let upper = select(angle, PI - angle, x < 0.0);
    return select(upper, -upper, y < 0.0);
}

// `acos(x) = √(1−x)·P(x)` for 0 ≤ x ≤ 1.
const ACOS = array(
    1.5707964, -0.2145988, 0.08897899, -0.050174303, 0.03089188, -0.017088126, 0.00667009, -0.0012624911,
);

fn arc_cosine(x: f32) -> f32 {
    let a = min(abs(x), 1.0);
    var sum = 0.0;
    for (var k = 7; k >= 0; k--) {
        sum = sum * a + ACOS[k];
    }
    let angle = sqrt(1.0 - a) * sum;
    return select(angle, PI - angle, x < 0.0);
}
