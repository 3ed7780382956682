//! Values over time that are given by rows `(t, value)` in order of time: piecewise linear, with a jump where a time occurs twice.

use crate::time::TimeNode;

/// Returns the value at the instant `t`, zero outside of the rows: at a jump the value just after it, at the last row the last one.
pub fn value(rows: &[(f64, f64)], t: f64) -> f64 {
    let (Some(first), Some(last)) = (rows.first(), rows.last()) else {
        return 0.0;
    };
    // A NaN also counts as outside.
    if !(first.0..=last.0).contains(&t) {
        return 0.0;
    }
    let next = rows.partition_point(|&(time, _)| time <= t);
    let (t0, f0) = rows[next.saturating_sub(1)];
    let Some(&(t1, f1)) = rows.get(next) else {
        return f0;
    };
    f0 + (f1 - f0) * (t - t0) / (t1 - t0)
}

/// Returns the value at the instant `t`: before the first row the first value, after the last row the last one.
pub fn kept(rows: &[(f64, f64)], t: f64) -> f64 {
    // A constant, at every step of a motion under one.
    if let [(_, only)] = rows {
        return *only;
    }
    match (rows.first(), rows.last()) {
        (Some(first), _) if t < first.0 => first.1,
        (_, Some(last)) if t > last.0 => last.1,
        _ => value(rows, t),
    }
}

/// Returns [`value`] at a time node for the steps on both sides, with jumps shared between the time nodes beside them (see
/// [loads](super)).
pub fn at_node(rows: &[(f64, f64)], node: &TimeNode) -> f64 {
    let at = value(rows, node.time);
    let (Some(first), Some(last)) = (rows.first(), rows.last()) else {
        return at;
    };
    if !(node.before + node.after > 0.0) {
        return at;
    }
    // At the last row [`value`] has the last value.
    let at = at + moved(node, first.0, first.1, first.0 <= node.time);
    let at = at + moved(node, last.0, -last.1, last.0 < node.time);
    with_inner_jumps(at, rows, node)
}

/// Returns [`kept`] at a time node, with jumps shared like those of [`at_node`].
pub fn kept_at_node(rows: &[(f64, f64)], node: &TimeNode) -> f64 {
    let at = kept(rows, node.time);
    if rows.len() < 2 || !(node.before + node.after > 0.0) {
        return at;
    }
    with_inner_jumps(at, rows, node)
}

/// Adds to the value at the instant of a node what its share of all jumps between two rows differs by from those that are in the value.
fn with_inner_jumps(at: f64, rows: &[(f64, f64)], node: &TimeNode) -> f64 {
    let from = rows.partition_point(|&(own, _)| own < node.time - node.before);
    let to = rows.partition_point(|&(own, _)| own <= node.time + node.after);
    let jumps = rows[from..to].windows(2);
    (jumps.filter(|pair| pair[0].0 == pair[1].0)).fold(at, |at, pair| {
        at + moved(
            node,
            pair[0].0,
            pair[1].1 - pair[0].1,
            pair[0].0 <= node.time,
        )
    })
}

/// Returns the node's share of a step of `size` that rises at `start`, less the step itself where it `is_in` the value at the node.
fn moved(node: &TimeNode, start: f64, size: f64, is_in: bool) -> f64 {
    let &TimeNode {
        time: t,
        before,
        after,
    } = node;
    let part = |length: f64, distance: f64| {
        // Fraction of the half of the hat of the given `length` that lies farther than `distance` from the node.
        let rest = (1.0 - distance / length).clamp(0.0, 1.0);
        if length > 0.0 {
            length * rest * rest
        } else {
            0.0
        }
    };
    let covered = if start >= t {
        part(after, start - t)
    } else {
        after + before - part(before, t - start)
    };
    size * (covered / (before + after) - f64::from(u8::from(is_in)))
}
