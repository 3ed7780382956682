//! How elements are shared out along the length.

use softarm::mechanics::Mesh;

/// Returns the numbers of elements between the breaks.
fn shares(n_elements: usize, breaks: &[f64]) -> Vec<usize> {
    let mesh = Mesh::new(n_elements, breaks, 1);
    let ends = breaks.iter().chain(&[0.0, 1.0]);
    let mut nodes: Vec<usize> = ends.map(|s| mesh.node_at(*s).expect("a node")).collect();
    nodes.sort_unstable();
    nodes.dedup();
    assert_eq!(nodes.len(), mesh.n_pieces() + 1);
    nodes.windows(2).map(|ends| ends[1] - ends[0]).collect()
}

/// Elements are shared out by length, at least one to a piece, wherever and however often a break is named.
#[test]
fn elements_are_shared_out_by_length() {
    assert_eq!(shares(10, &[]), [10]);
    assert_eq!(shares(10, &[0.3]), [3, 7]);
    assert_eq!(shares(10, &[0.0, 1.0, 0.3, 0.3 + 1e-12]), [3, 7]);
    assert_eq!(shares(10, &[0.53, 0.2]), [2, 3, 5]);
    assert_eq!(shares(4, &[0.01, 0.02]), [1, 1, 2]);
    assert_eq!(shares(2, &[0.01, 0.02]), [1, 1, 1]);
    assert_eq!(shares(7, &[0.5]), [4, 3]);
}

/// A mesh with three times the elements, in lots of three, has the nodes of the coarse one at every third of its own.
#[test]
fn meshes_in_lots_are_nested() {
    let breaks = [0.137, 0.8, 0.55];
    for n_elements in 4..40 {
        let coarse = Mesh::new(n_elements, &breaks, 1);
        let fine = Mesh::new(3 * n_elements, &breaks, 3);
        assert_eq!(fine.n_elements(), 3 * n_elements);
        for node in 0..=n_elements {
            let apart = fine.fraction(3 * node) - coarse.fraction(node);
            assert!(apart.abs() < 1e-15, "{n_elements} {node}: {apart:e}");
        }
    }
}

/// Breaks are nodes, lengths add up, and every node is the nearest one to its own place.
#[test]
fn breaks_are_nodes() {
    let breaks = [0.2, 0.53, 0.9];
    for n_elements in 4..60 {
        let mesh = Mesh::new(n_elements, &breaks, 1);
        for s in breaks {
            assert!((mesh.fraction(mesh.nearest(s)) - s).abs() < 1e-15);
        }
        let whole: f64 = (0..n_elements).map(|q| mesh.length(q, 2.0)).sum();
        assert!((whole - 2.0).abs() < 1e-14);
        for (node, s) in mesh.fractions().into_iter().enumerate() {
            assert_eq!(mesh.nearest(s), node);
        }
    }
}
