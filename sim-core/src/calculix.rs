//! The mechanical problem of one load as an input deck, so that CalculiX can check the deformation.
//! Uses: `mesh`, `deformation::NodeForce`. Never: files, assembling, solving.
//!
//! `ccx NAME` (for `NAME.inp`) writes U of the foam's bottom and top to `NAME.dat` with 7 digits
//! and of all nodes to `NAME.frd` with 6. Same bricks (C3D8: 2x2x2 points, no B-bar), also the
//! collapsed ones of the rim; same materials; bottom fixed; each contact as six point forces; small
//! strains. Units: mm, N, MPa. Node `1 + level * plane + node`; level 0 is the bottom.

use std::collections::BTreeMap;
use std::fmt::{Arguments, Write as _};

use crate::deformation::NodeForce;
use crate::mesh::Mesh;

/// Entries on a line of a node set.
const PER_LINE: usize = 10;

/// Number of a node in the deck.
pub fn node_number(mesh: &Mesh, level: usize, node: usize) -> usize {
    1 + level * mesh.plane_nodes() + node
}

/// The deck of a load on the surface; `title` is its heading. CalculiX reads at most 20 characters
/// of a number, so coordinates and forces have 13 digits.
pub fn deck(title: &str, mesh: &Mesh, forces: &[NodeForce]) -> String {
    let mut deck = Deck(String::new());
    deck.line(format_args!("*HEADING\n{}", title.replace('\n', " ")));
    deck.nodes(mesh);
    deck.layers(mesh);
    deck.level_set(mesh, "FIXED", 0);
    deck.level_set(mesh, "FOAMBOTTOM", mesh.foam_levels[0]);
    deck.level_set(mesh, "FOAMTOP", mesh.foam_levels[1]);
    deck.line(format_args!("*BOUNDARY\nFIXED, 1, 3"));
    deck.line(format_args!("*STEP\n*STATIC"));
    // Forces of neighbouring contacts on one node are summed: one line per node.
    let mut on_node: BTreeMap<u32, f64> = BTreeMap::new();
    for force in forces {
        *on_node.entry(force.node).or_default() += force.force_n;
    }
    if !on_node.is_empty() {
        deck.line(format_args!("*CLOAD"));
    }
    let surface = mesh.levels() - 1;
    for (node, force_n) in on_node {
        deck.line(format_args!(
            "{}, 3, {:.12e}",
            node_number(mesh, surface, node as usize),
            -force_n
        ));
    }
    deck.line(format_args!("*NODE PRINT, NSET=FOAMBOTTOM\nU\n*NODE PRINT, NSET=FOAMTOP\nU"));
    deck.line(format_args!("*NODE FILE\nU\n*END STEP"));
    deck.0
}

struct Deck(String);

impl Deck {
    fn line(&mut self, text: Arguments<'_>) {
        self.0.write_fmt(text).expect("a String takes any text");
        self.0.push('\n');
    }

    fn nodes(&mut self, mesh: &Mesh) {
        self.line(format_args!("*NODE, NSET=ALL"));
        for (level, z) in mesh.level_heights_mm().into_iter().enumerate() {
            for (node, [x, y]) in mesh.nodes_mm.iter().enumerate() {
                let number = node_number(mesh, level, node);
                self.line(format_args!("{number}, {x:.12e}, {y:.12e}, {z:.12e}"));
            }
        }
    }

    /// Bricks, material and section of each layer.
    fn layers(&mut self, mesh: &Mesh) {
        let [foam, top] = mesh.foam_levels;
        for (name, levels) in
            [("BOTTOM", 0..foam), ("FOAM", foam..top), ("TOP", top..mesh.sheets.len())]
        {
            let sheet = &mesh.sheets[levels.start];
            self.line(format_args!("*ELEMENT, TYPE=C3D8, ELSET={name}"));
            for level in levels {
                for (i, cell) in mesh.cells.iter().enumerate() {
                    let number = 1 + level * mesh.cells.len() + i;
                    let [a, b, c, d] = cell.map(|n| node_number(mesh, level, n as usize));
                    let [e, f, g, h] = cell.map(|n| node_number(mesh, level + 1, n as usize));
                    self.line(format_args!("{number}, {a}, {b}, {c}, {d}, {e}, {f}, {g}, {h}"));
                }
            }
            self.line(format_args!("*MATERIAL, NAME={name}\n*ELASTIC"));
            self.line(format_args!("{:.12e}, {:.12e}", sheet.youngs_mpa, sheet.poisson));
            self.line(format_args!("*SOLID SECTION, ELSET={name}, MATERIAL={name}"));
        }
    }

    fn level_set(&mut self, mesh: &Mesh, name: &str, level: usize) {
        self.line(format_args!("*NSET, NSET={name}"));
        let numbers: Vec<String> = (0..mesh.plane_nodes())
            .map(|node| node_number(mesh, level, node).to_string())
            .collect();
        for chunk in numbers.chunks(PER_LINE) {
            self.line(format_args!("{}", chunk.join(", ")));
        }
    }
}
