//! Constants of nodes and elements, in blocks.

use super::element::{Consistent, SectionLaw, Standard};
use super::place::{Slot, Slots};
use super::rule::Rule;
use super::sweep::{GYRATION, MOBILITY, NODE_ROWS, WEIGHT};
use cosserat::buffer::Buffer;
use cosserat::element::StrainRule;
use cosserat::element::{Helical, RodModel, Trapezoidal};
use cosserat::rod::{NodeInertia, Rod};

/// Rotary inertia of held nodes: no moment turns them, and the fourth power of its inverse is not subnormal, which would be slow.
pub const HELD_INERTIA: f64 = 1e50;

/// Constants of nodes and elements in blocks; equal neighbors share one.
#[derive(Clone, Debug)]
pub struct Constants {
    pub nodes: Buffer,
    pub elements: Buffer,
    /// For every block, the indices of its blocks of `nodes` and of `elements`.
    pub kinds: Vec<[usize; 2]>,
}

impl Constants {
    pub fn new(rod: &Rod, slots: Slots, time_step: f64) -> Self {
        let mut nodes = Kinds::default();
        let mut elements = Kinds::default();
        let mut kinds = Vec::with_capacity(slots.n_blocks);
        for block in 0..slots.n_blocks {
            let mut node_block = vec![0.0; NODE_ROWS * slots.n_lanes];
            let mut element_block = vec![0.0; element_rows(rod) * slots.n_lanes];
            write_block(
                rod,
                slots,
                time_step,
                block,
                &mut node_block,
                &mut element_block,
            );
            // The mass of the tip may change alone.
            let has_tip = block == slots.place(rod.tip()).block;
            kinds.push([
                nodes.of(node_block, has_tip),
                elements.of(element_block, false),
            ]);
        }
        Self {
            nodes: nodes.into_buffer(),
            elements: elements.into_buffer(),
            kinds,
        }
    }

    /// Rewrites the constants for another step length, and for a rod whose elements are all stiffer or softer by the same factor, and whose
    /// tip is heavier or lighter: blocks that were equal remain equal.
    pub fn rewrite(&mut self, rod: &Rod, slots: Slots, time_step: f64) {
        let node_size = NODE_ROWS * slots.n_lanes;
        let element_size = element_rows(rod) * slots.n_lanes;
        for (block, &[node, element]) in self.kinds.iter().enumerate() {
            let nodes = &mut self.nodes[node * node_size..][..node_size];
            let elements = &mut self.elements[element * element_size..][..element_size];
            write_block(rod, slots, time_step, block, nodes, elements);
        }
    }
}

fn element_rows(rod: &Rod) -> usize {
    match rod.model {
        RodModel::Standard => Standard::ROWS,
        RodModel::Dilatation | RodModel::Consistent => Consistent::ROWS,
    }
}

/// Returns the constants of the nodes of a block, and of the elements that begin there.
fn write_block(
    rod: &Rod,
    slots: Slots,
    time_step: f64,
    block: usize,
    nodes: &mut [f64],
    elements: &mut [f64],
) {
    for lane in 0..slots.n_lanes {
        let node = slots.node(Slot { block, lane });
        let mut rows = if node < rod.first_free_node() || node >= rod.n_nodes() {
            held_constants(rod.model == RodModel::Standard)
        } else {
            node_constants(rod, node, time_step)
        };
        if let Some(joint) = rod.joint(node) {
            rows[MOBILITY] = 0.0;
            if !joint.turns() {
                rows[GYRATION..].fill(0.0);
            }
        }
        for (row, value) in rows.iter().enumerate() {
            nodes[row * slots.n_lanes + lane] = *value;
        }
        if node >= rod.n_elements() {
            continue;
        }
        let rows = match rod.strain_rule {
            StrainRule::Helical => Helical::constants(rod, node, time_step),
            StrainRule::Trapezoidal => Trapezoidal::constants(rod, node, time_step),
        };
        for (row, value) in rows[..element_rows(rod)].iter().enumerate() {
            elements[row * slots.n_lanes + lane] = *value;
        }
    }
}

/// Distinct blocks one after the other.
#[derive(Default)]
struct Kinds {
    blocks: Vec<Vec<f64>>,
    /// Tells whether the last block must not be shared.
    alone: bool,
}

impl Kinds {
    /// Returns the index of a block, which is the last one if they are equal and may be shared.
    fn of(&mut self, block: Vec<f64>, alone: bool) -> usize {
        if alone || self.alone || self.blocks.last() != Some(&block) {
            self.blocks.push(block);
        }
        self.alone = alone;
        self.blocks.len() - 1
    }

    fn into_buffer(self) -> Buffer {
        let numbers = self.blocks.concat();
        let mut buffer = Buffer::zeros(numbers.len());
        buffer.copy_from_slice(&numbers);
        buffer
    }
}

fn held_constants(standard: bool) -> [f64; NODE_ROWS] {
    let mut rows = [0.0; NODE_ROWS];
    if !standard {
        rows[GYRATION..][..3].fill(HELD_INERTIA);
    }
    rows
}

fn node_constants(rod: &Rod, node: usize, h: f64) -> [f64; NODE_ROWS] {
    let NodeInertia { mass, rotary: j } = &rod.nodes[node];
    let mut rows = [0.0; NODE_ROWS];
    rows[MOBILITY] = h / mass;
    rows[WEIGHT..WEIGHT + 3].copy_from_slice(rod.weight(node).as_slice());
    // Three different moments of inertia get an infinite level, so that the node is always turned singly.
    if rod.model == RodModel::Standard {
        rows[GYRATION] = h / j.x;
        rows[GYRATION + 1] = h / j.z;
        rows[GYRATION + 2] = if j.x == j.y {
            (j.z - j.x) / j.x
        } else {
            f64::INFINITY
        };
        rows[GYRATION + 3] = 4.0 * (j.z - j.x) / h;
    } else {
        rows[GYRATION..][..3].copy_from_slice(j.as_slice());
        let left = (node > 0).then(|| rod.element_inertia[node - 1][1]);
        let right = rod.element_inertia.get(node).map(|ends| ends[0]);
        let mut shares = left.iter().chain(&right);
        let axisymmetric = j.x == j.y && shares.all(|share| share.rotary.x == share.rotary.y);
        rows[GYRATION + 3] = if axisymmetric { 0.0 } else { f64::INFINITY };
    }
    rows
}
