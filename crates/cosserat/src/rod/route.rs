//! Lines of actuators in the arm at rest.

/// The line of an actuator in the arm at rest.
///
/// Between `from` and `to` the offset goes linearly from `offset_from` to `offset_to` and turns with the section's axes by `turns`
/// revolutions, positive about `e₃`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Route {
    /// Start, as a fraction of the rest length from the base.
    pub from: f64,
    /// End, as such a fraction.
    pub to: f64,
    /// Offset in the section at the start, along its two axes, m.
    pub offset_from: [f64; 2],
    /// Offset at the end before it is turned, m.
    pub offset_to: [f64; 2],
    /// Revolutions from start to end.
    pub turns: f64,
}

impl Route {
    /// Returns a line parallel to the axis over the whole arm.
    #[must_use]
    pub fn straight(offset: [f64; 2]) -> Self {
        Self {
            from: 0.0,
            to: 1.0,
            offset_from: offset,
            offset_to: offset,
            turns: 0.0,
        }
    }

    /// Returns the offset `d` (m) and its derivative `d'` along the rest length at the fraction `s` of an arm of length `length` (m).
    #[must_use]
    pub fn at(&self, s: f64, length: f64) -> ([f64; 2], [f64; 2]) {
        let span = self.to - self.from;
        let part = (s - self.from) / span;
        let (sin, cos) = (std::f64::consts::TAU * self.turns * part).sin_cos();
        let rate = std::f64::consts::TAU * self.turns / (span * length);
        let [x, y] =
            [0, 1].map(|i| self.offset_from[i] + (self.offset_to[i] - self.offset_from[i]) * part);
        let [vx, vy] = [0, 1].map(|i| (self.offset_to[i] - self.offset_from[i]) / (span * length));
        let offset = [cos * x - sin * y, sin * x + cos * y];
        let slope = [
            cos * vx - sin * vy - rate * offset[1],
            sin * vx + cos * vy + rate * offset[0],
        ];
        (offset, slope)
    }

    /// Returns the points at which an integral over the part of the line between two fractions of a rod is evaluated, for elements of these
    /// lengths, m.
    pub(super) fn points(&self, within: [f64; 2], lengths: &[f64]) -> Vec<RoutePoint> {
        let length: f64 = lengths.iter().sum();
        let (from, to) = (self.from.max(within[0]), self.to.min(within[1]));
        let (mut out, mut start) = (Vec::new(), 0.0);
        for (q, own) in lengths.iter().enumerate() {
            let end = if q + 1 == lengths.len() {
                length
            } else {
                start + own
            };
            let first = start.max(from * length);
            let covered = end.min(to * length) - first;
            start = end;
            // What rounding leaves of an element beside the end of an actuator.
            if covered <= own * 1e-12 {
                continue;
            }
            for &(place, weight) in self.rule() {
                let s = (first + place * covered) / length;
                let (offset, slope) = self.at(s, length);
                out.push(RoutePoint {
                    element: q,
                    offset,
                    slope,
                    length: weight * covered,
                });
            }
        }
        out
    }

    /// Returns the points of the Gauss rule on the unit interval by which an element is integrated, with their weights: one where the line
    /// keeps its direction in the section, two where it turns.
    fn rule(&self) -> &'static [(f64, f64)] {
        const ONE: [(f64, f64); 1] = [(0.5, 1.0)];
        // ½ (1 ∓ 1/√3)
        const TWO: [(f64, f64); 2] = [
            (0.211_324_865_405_187_13, 0.5),
            (0.788_675_134_594_812_9, 0.5),
        ];
        if self.turns == 0.0 { &ONE } else { &TWO }
    }
}

/// A point of a line at which an integral along it is evaluated.
pub(super) struct RoutePoint {
    /// Index of its element.
    pub element: usize,
    /// Offset in the section, m.
    pub offset: [f64; 2],
    /// Its derivative along the rest length.
    pub slope: [f64; 2],
    /// Length of the rod for which it stands, m.
    pub length: f64,
}
