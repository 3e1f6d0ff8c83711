//! Circles of imports: strongly connected files (Tarjan, 1972).

use super::{Graph, Module, edges};
use std::collections::BTreeMap;

/// The circles, each as its imports with file and line.
pub(super) fn circles(graph: &Graph) -> Vec<Vec<String>> {
    let mut search = Search {
        graph,
        numbers: BTreeMap::new(),
        lowest: BTreeMap::new(),
        open: Vec::new(),
        groups: Vec::new(),
    };
    for module in graph.keys() {
        if !search.numbers.contains_key(module) {
            search.visit(module);
        }
    }
    let circles = search.groups.into_iter().filter(|group| group.len() > 1);
    let shown = |group: Vec<&Module>| {
        edges(graph)
            .filter(|(from, to, _)| group.contains(from) && group.contains(to))
            .map(|(from, to, import)| format!("{}: {} imports {}", import.place, from.join("::"), to.join("::")))
            .collect()
    };
    circles.map(shown).collect()
}

struct Search<'a> {
    graph: &'a Graph,
    /// Order of the visits.
    numbers: BTreeMap<&'a Module, usize>,
    /// Lowest number that can be reached from a module.
    lowest: BTreeMap<&'a Module, usize>,
    open: Vec<&'a Module>,
    groups: Vec<Vec<&'a Module>>,
}

impl<'a> Search<'a> {
    fn visit(&mut self, module: &'a Module) -> usize {
        let number = self.numbers.len();
        self.numbers.insert(module, number);
        self.open.push(module);
        let mut lowest = number;
        for (next, _) in self.graph.get(module).into_iter().flatten() {
            let reached = match self.numbers.get(next) {
                None => self.visit(next),
                Some(number) if self.open.contains(&next) => *number,
                Some(_) => continue,
            };
            lowest = lowest.min(reached);
        }
        self.lowest.insert(module, lowest);
        if lowest == number
            && let Some(first) = self.open.iter().position(|open| *open == module)
        {
            self.groups.push(self.open.split_off(first));
        }
        lowest
    }
}
