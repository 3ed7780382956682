//! Efforts of lagging actuators that fall toward a bound as fast as their commands allow.

use softarm::control::holding::ends::ratio;
use softarm::control::{ControlGrid, Hold};

/// Coefficients that fall by the ratio, from any lag, have commands that are not negative on grids of equal blocks, for both holds.
#[test]
fn efforts_fall_as_fast_as_commands_allow() {
    for hold in [Hold::Linear, Hold::Cubic] {
        for lag in [0.01, 0.1, 1.0] {
            let grid = ControlGrid::new(hold, 8, 80, 0.01).unwrap();
            let mut u = vec![1.0];
            for gap in grid.rate_gaps() {
                u.push(u[u.len() - 1] * ratio(lag / gap, hold == Hold::Cubic));
            }
            for row in grid.command_rows(lag) {
                let command: f64 = row.iter().map(|(j, weight)| weight * u[*j]).sum();
                assert!(command > -1e-12, "{hold:?} {lag}: {command}");
            }
        }
    }
}
