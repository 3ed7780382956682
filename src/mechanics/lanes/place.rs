//! The place of a node's numbers: its block and its lane; see [`sweep`](super::sweep) for the order of the nodes.

/// The blocks of a rod.
#[derive(Clone, Copy, Debug)]
pub struct Slots {
    pub n_blocks: usize,
    pub n_lanes: usize,
}

/// A block, and a lane in each of its rows.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    pub block: usize,
    pub lane: usize,
}

/// Place of node 0.
pub const BASE: Place = Place { block: 0, lane: 0 };

impl Slots {
    #[inline]
    pub fn place(self, node: usize) -> Place {
        Place {
            block: node % self.n_blocks,
            lane: node / self.n_blocks,
        }
    }

    /// Returns the index of a row among blocks of `n_rows` rows.
    #[inline]
    pub fn index(self, place: Place, n_rows: usize, row: usize) -> usize {
        (place.block * n_rows + row) * self.n_lanes + place.lane
    }

    #[inline]
    pub fn node(self, place: Place) -> usize {
        place.lane * self.n_blocks + place.block
    }

    pub fn len(self) -> usize {
        self.n_blocks * self.n_lanes
    }
}
