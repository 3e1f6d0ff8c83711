//! Call graph of an image, and the stack depth that follows from it.

use super::thumb;
use super::thumb::Effect;
use super::{Function, Image, LONG_BRANCH};
use std::collections::{BTreeMap, BTreeSet};

/// Most nested calls through a register within one task.
///
/// Such a call counts as a call of the deepest function whose address is in the image. The firmware makes such calls
/// for wakers, formatting and serialisation only.
pub const INDIRECT_NESTING: u32 = 3;

/// Properties of one function.
#[derive(Clone, Debug, Default)]
struct Node {
    /// Bytes of the function's own frame: the sum of everything that any path through it allocates.
    stack_bytes: u32,
    stack_unknown: bool,
    calls: BTreeSet<u32>,
    /// Functions whose address it takes.
    takes: BTreeSet<u32>,
    indirect: bool,
    masks: bool,
}

/// The deepest stack of a task.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StackBound {
    /// At most this many bytes.
    Bytes(u32),
    /// Unbounded: a function calls itself directly or indirectly.
    Recursive {
        /// Its name.
        function: String,
    },
    /// Unknown: the stack pointer is written in a way that is not understood.
    Unknown {
        /// The function that writes it.
        function: String,
    },
}

/// The call graph of an image.
#[derive(Clone, Debug)]
pub struct CallGraph<'a> {
    image: &'a Image,
    nodes: BTreeMap<u32, Node>,
    last: BTreeSet<u32>,
    /// Stack below a call through a register.
    indirect_bytes: u32,
}

impl<'a> CallGraph<'a> {
    /// Analyses all functions of an image.
    ///
    /// A function whose name contains one of the parts `last` ends the program with all interrupts masked: it runs
    /// once, whatever it has interrupted, so its stack is not added to that of its callers.
    #[must_use]
    pub fn new(image: &'a Image, last: &[&str]) -> Self {
        let nodes = image
            .functions()
            .iter()
            .map(|function| (function.address, node(image, function)))
            .collect();
        let is_last = |function: &&Function| last.iter().any(|part| function.name.contains(part));
        let last = image
            .functions()
            .iter()
            .filter(is_last)
            .map(|function| function.address);
        let mut graph = Self {
            image,
            nodes,
            last: last.collect(),
            indirect_bytes: 0,
        };
        let taken = graph.taken();
        for _ in 0..INDIRECT_NESTING {
            let mut depths = BTreeMap::new();
            graph.indirect_bytes = taken
                .iter()
                .filter_map(|address| graph.depth(*address, &mut depths, &mut Vec::new()).ok())
                .max()
                .unwrap_or(0);
        }
        graph
    }

    /// Functions whose address is taken by code or stored in the image as data, except in the vector table. An instruction
    /// that reads like an address is not counted.
    fn taken(&self) -> BTreeSet<u32> {
        let formed = self.nodes.values().flat_map(|node| node.takes.iter().copied());
        let mut taken: BTreeSet<u32> = formed.filter(|address| self.nodes.contains_key(address)).collect();
        for section in self.image.sections() {
            if section.name == ".vector_table" {
                continue;
            }
            for address in (section.address..section.address.saturating_add(section.size)).step_by(4) {
                let value = self.image.word(address).unwrap_or(0);
                let is_instruction = self.image.function_at(address).is_some() && self.image.is_code(address);
                if value & 1 == 1 && self.nodes.contains_key(&(value & !1)) && !is_instruction {
                    taken.insert(value & !1);
                }
            }
        }
        taken
    }

    /// All functions that may run when the function at `root` is called, except those called through registers; the
    /// first is `root`.
    #[must_use]
    pub fn reachable(&self, root: &Function) -> Vec<&Function> {
        let mut found = vec![root.address];
        let mut next = 0;
        while let Some(address) = found.get(next).copied() {
            next += 1;
            let Some(node) = self.nodes.get(&address) else { continue };
            for call in &node.calls {
                if !found.contains(call) {
                    found.push(*call);
                }
            }
        }
        found
            .iter()
            .filter_map(|address| self.image.function_at(*address))
            .collect()
    }

    /// A shortest chain of calls from `root` to a function, including both; empty if there is none.
    #[must_use]
    pub fn chain(&self, root: &Function, to: &Function) -> Vec<&Function> {
        let mut before = BTreeMap::from([(root.address, root.address)]);
        let mut queue = std::collections::VecDeque::from([root.address]);
        while let Some(address) = queue.pop_front() {
            let calls = self.nodes.get(&address).into_iter().flat_map(|node| &node.calls);
            for call in calls {
                before.entry(*call).or_insert_with(|| {
                    queue.push_back(*call);
                    address
                });
            }
        }
        let mut chain = Vec::new();
        let mut at = to.address;
        while let Some(caller) = before.get(&at) {
            chain.extend(self.image.function_at(at));
            if at == root.address {
                break;
            }
            at = *caller;
        }
        chain.reverse();
        chain
    }

    /// Whether a function calls through a register.
    #[must_use]
    pub fn calls_indirectly(&self, function: &Function) -> bool {
        self.nodes.get(&function.address).is_some_and(|node| node.indirect)
    }

    /// Whether a call through a register may enter a function: its address is somewhere in the image.
    #[must_use]
    pub fn is_called_indirectly(&self, function: &Function) -> bool {
        self.taken().contains(&function.address)
    }

    /// Whether a function masks interrupts.
    #[must_use]
    pub fn masks_interrupts(&self, function: &Function) -> bool {
        self.nodes.get(&function.address).is_some_and(|node| node.masks)
    }

    /// Bytes of a function's own frame.
    #[must_use]
    pub fn frame(&self, function: &Function) -> u32 {
        self.nodes.get(&function.address).map_or(0, |node| node.stack_bytes)
    }

    /// The deepest stack when the function at `root` is called.
    #[must_use]
    pub fn stack(&self, root: &Function) -> StackBound {
        match self.depth(root.address, &mut BTreeMap::new(), &mut Vec::new()) {
            Ok(bytes) => StackBound::Bytes(bytes),
            Err(bound) => bound,
        }
    }

    fn depth(&self, address: u32, known: &mut BTreeMap<u32, u32>, path: &mut Vec<u32>) -> Result<u32, StackBound> {
        if let Some(bytes) = known.get(&address) {
            return Ok(*bytes);
        }
        let name = || {
            self.image
                .function_at(address)
                .map_or_else(|| format!("{address:#x}"), |function| function.name.clone())
        };
        if path.contains(&address) {
            return Err(StackBound::Recursive { function: name() });
        }
        let Some(node) = self.nodes.get(&address) else {
            return Ok(0);
        };
        if node.stack_unknown {
            return Err(StackBound::Unknown { function: name() });
        }
        path.push(address);
        let mut below = if node.indirect { self.indirect_bytes } else { 0 };
        for call in node.calls.difference(&self.last) {
            below = below.max(self.depth(*call, known, path)?);
        }
        path.pop();
        let bytes = node.stack_bytes.saturating_add(below);
        known.insert(address, bytes);
        Ok(bytes)
    }
}

fn node(image: &Image, function: &Function) -> Node {
    let mut node = Node::default();
    let mut constants = [0u32; 16];
    // Bytes that a register points below the stack pointer.
    let mut below: [Option<u32>; 16] = [None; 16];
    let end = function.address.saturating_add(function.size);
    let mut address = function.address;
    while address < end {
        if !image.is_code(address) {
            address = address.saturating_add(2);
            continue;
        }
        let (Some(first), second) = (image.halfword(address), image.halfword(address.saturating_add(2))) else {
            break;
        };
        match thumb::decode(address, first, second.unwrap_or(0)) {
            Effect::Stack(bytes) => node.stack_bytes = node.stack_bytes.saturating_add(bytes),
            Effect::StackRegister(register) => {
                let bytes = constants.get(usize::from(register)).copied().unwrap_or(0);
                node.stack_bytes = node.stack_bytes.saturating_add(bytes);
                node.stack_unknown |= bytes == 0;
            }
            Effect::Below(register, bytes) => {
                if let Some(slot) = below.get_mut(usize::from(register)) {
                    *slot = Some(bytes);
                }
            }
            Effect::Align(register, bits) => {
                if let Some(Some(bytes)) = below.get_mut(usize::from(register)) {
                    *bytes = bytes.saturating_add((1 << bits.min(31)) - 1);
                }
            }
            Effect::StackFrom(register) => match below.get(usize::from(register)).copied().flatten() {
                Some(bytes) => node.stack_bytes = node.stack_bytes.saturating_add(bytes),
                None => node.stack_unknown = true,
            },
            Effect::Constant(register, value, upper) => {
                if let Some(constant) = constants.get_mut(usize::from(register)) {
                    *constant = match upper {
                        false => u32::from(value),
                        true => *constant & 0xFFFF | u32::from(value) << 16,
                    };
                    if upper && *constant & 1 == 1 {
                        node.takes.insert(*constant & !1);
                    }
                }
            }
            Effect::Call(target) => {
                node.calls.insert(entry(image, target));
            }
            Effect::Jump(target) if !(function.address..end).contains(&target) => {
                node.calls.insert(entry(image, target));
            }
            Effect::Indirect => node.indirect = true,
            Effect::Mask => node.masks = true,
            Effect::Jump(_) | Effect::Other => {}
        }
        address = address.saturating_add(thumb::length(first));
    }
    if function.name.starts_with(LONG_BRANCH) {
        let [.., target, _, _, _] = constants;
        return Node {
            calls: BTreeSet::from([entry(image, target & !1)]),
            ..Node::default()
        };
    }
    node
}

/// The start of the function that a call enters.
fn entry(image: &Image, target: u32) -> u32 {
    image.function_at(target).map_or(target, |function| function.address)
}
