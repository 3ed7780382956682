//! The place of a node's numbers: its block, row and lane; see [`sweep`](super::sweep) for the order of the nodes.

/// Number of rows of a block of nodes.
pub const STATE_ROWS: usize = 19;
/// Position, spatial frame, m.
pub const POSITION: usize = 0;
/// Rotation, unit quaternion w, x, y, z.
pub const ROTATION: usize = 3;
/// Linear momentum of the last half step, damped: `(p - h/2 f)/(1 + a)` with momentum `p` and force `f` at the time node.
pub const LINEAR_MOMENTUM: usize = 7;
/// Angular momentum, defined in the same way, body frame.
pub const ANGULAR_MOMENTUM: usize = 10;
/// Force, spatial frame, without the control.
pub const FORCE: usize = 13;
/// Moment, body frame, without the control.
pub const MOMENT: usize = 16;

/// The blocks of a rod.
#[derive(Clone, Copy, Debug)]
pub struct Slots {
    pub n_blocks: usize,
    pub n_lanes: usize,
}

/// A block, and a lane in each of its rows.
#[derive(Clone, Copy, Debug)]
pub struct Slot {
    pub block: usize,
    pub lane: usize,
}

/// Place of node 0.
pub const BASE: Slot = Slot { block: 0, lane: 0 };

impl Slots {
    #[inline]
    pub fn place(self, node: usize) -> Slot {
        Slot {
            block: node % self.n_blocks,
            lane: node / self.n_blocks,
        }
    }

    /// Returns the index of a row among blocks of `n_rows` rows.
    #[inline]
    pub fn index(self, place: Slot, n_rows: usize, row: usize) -> usize {
        (place.block * n_rows + row) * self.n_lanes + place.lane
    }

    #[inline]
    pub fn node(self, place: Slot) -> usize {
        place.lane * self.n_blocks + place.block
    }

    pub fn len(self) -> usize {
        self.n_blocks * self.n_lanes
    }
}
