//! How colours are seen, for the tests of both palettes: contrast (WCAG 2.2) and differences for eyes that
//! miss a kind of cone (Machado, Oliveira and Fernandes 2009, doi:10.1109/TVCG.2009.113, severity 1).
//! Colours are sRGB from 0 to 1.

/// Whose eyes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Eyes {
    /// Three kinds of cones.
    Usual,
    /// None for long waves.
    Protan,
    /// None for middle waves.
    Deutan,
    /// None for short waves.
    Tritan,
}

impl Eyes {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Usual, Self::Protan, Self::Deutan, Self::Tritan];

    fn matrix(self) -> [[f64; 3]; 3] {
        match self {
            Self::Usual => [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            Self::Protan => [
                [0.152286, 1.052583, -0.204868],
                [0.114503, 0.786281, 0.099216],
                [-0.003882, -0.048116, 1.051998],
            ],
            Self::Deutan => [
                [0.367322, 0.860646, -0.227968],
                [0.280085, 0.672501, 0.047413],
                [-0.011820, 0.042940, 0.968881],
            ],
            Self::Tritan => [
                [1.255528, -0.076749, -0.178779],
                [-0.078411, 0.930809, 0.147602],
                [0.004733, 0.691367, 0.303900],
            ],
        }
    }
}

fn linear(c: [f64; 3]) -> [f64; 3] {
    c.map(|s| {
        if s <= 0.04045 {
            s / 12.92
        } else {
            ((s + 0.055) / 1.055).powf(2.4)
        }
    })
}

/// Contrast ratio of WCAG 2.2, 1..21.
pub fn contrast(a: [f64; 3], b: [f64; 3]) -> f64 {
    let y = |c| {
        let [r, g, b] = linear(c);
        0.2126 * r + 0.7152 * g + 0.0722 * b
    };
    let (hi, lo) = if y(a) > y(b) {
        (y(a), y(b))
    } else {
        (y(b), y(a))
    };
    (hi + 0.05) / (lo + 0.05)
}

// CIE L*a*b*, D65.
fn lab([r, g, b]: [f64; 3]) -> [f64; 3] {
    let f = |t: f64| {
        if t > 0.008_856 {
            t.cbrt()
        } else {
            7.787 * t + 16.0 / 116.0
        }
    };
    let x = f((0.4124 * r + 0.3576 * g + 0.1805 * b) / 0.9505);
    let y = f(0.2126 * r + 0.7152 * g + 0.0722 * b);
    let z = f((0.0193 * r + 0.1192 * g + 0.9505 * b) / 1.089);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Distance of two colours in CIE L*a*b* as these eyes see them.
pub fn difference(eyes: Eyes, a: [f64; 3], b: [f64; 3]) -> f64 {
    let seen = |c| {
        let c = linear(c);
        let row = |r: [f64; 3]| (r[0] * c[0] + r[1] * c[1] + r[2] * c[2]).clamp(0.0, 1.0);
        lab(eyes.matrix().map(row))
    };
    let (a, b) = (seen(a), seen(b));
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn contrast_has_its_anchors() {
    assert!((contrast([1.0; 3], [0.0; 3]) - 21.0).abs() < 1e-9);
    let grey = [f64::from(0x77) / 255.0; 3];
    assert!((contrast(grey, [1.0; 3]) - 4.48).abs() < 0.01);
}

#[test]
fn red_and_green_look_alike_only_to_some_eyes() {
    // Of equal lightness to deuteranopes.
    let (red, green) = ([0.75, 0.35, 0.25], [0.47, 0.52, 0.25]);
    assert!(difference(Eyes::Usual, red, green) > 40.0);
    assert!(difference(Eyes::Deutan, red, green) < 15.0);
}
