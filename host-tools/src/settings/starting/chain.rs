//! What a scan of the bus tells a configuration: how many drives there are, what they are, and where the terminals stand.

use toml_edit::{DocumentMut, Item, Table, TableLike, Value};

/// A slave that a scan has found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Found {
    /// The name that it tells.
    pub name: String,
    /// Whether it is a drive that an axis can use.
    pub is_drive: bool,
    /// Vendor number.
    pub vendor: u32,
    /// Product code.
    pub product: u32,
    /// Serial number; 0 if it has none.
    pub serial: u32,
    /// Alias; 0 if it has none.
    pub alias: u16,
    /// Number of its identification switches; 0 if it has none.
    pub switch: u16,
}

impl Found {
    /// The name as a comment can have it.
    fn printable(&self) -> String {
        let name: String = self.name.chars().filter(|letter| !letter.is_control()).collect();
        match name.trim() {
            "" => format!("vendor {:#x}, product {:#x}", self.vendor, self.product),
            name => name.to_owned(),
        }
    }
}

/// How the line of a sample begins that names the sample's own chain.
const SAMPLE_CHAIN: &str = "# The chain:";

/// A number of a drive.
type Number = fn(&Found) -> u32;

/// What tells equal drives apart: the first of these that all of them have that are used, each with a number of its own. What
/// stays with the place when a drive is replaced comes first.
const MARKS: [(&str, Number); 3] = [
    ("switch", |found| found.switch.into()),
    ("alias", |found| found.alias.into()),
    ("serial", |found| found.serial),
];

/// The drives of a chain, in its order.
pub(super) fn drives(chain: &[Found]) -> impl Iterator<Item = &Found> {
    chain.iter().filter(|found| found.is_drive)
}

fn is_equal(one: &Found, other: &Found) -> bool {
    (one.vendor, one.product) == (other.vendor, other.product)
}

/// What tells a drive from all equal ones of the chain, of which the first `axes` drives are used; `None` if it needs nothing,
/// or nothing does.
fn mark(of: &Found, chain: &[Found], axes: usize) -> Option<(&'static str, u32)> {
    let equal: Vec<&Found> = drives(chain).filter(|found| is_equal(found, of)).collect();
    let used: Vec<&Found> = drives(chain).take(axes).filter(|found| is_equal(found, of)).collect();
    let tells_apart = |number: Number| {
        let is_alone = |one: u32| equal.iter().filter(|other| number(other) == one).count() == 1;
        used.iter().all(|found| number(found) != 0 && is_alone(number(found)))
    };
    let found = MARKS.into_iter().find(|(_, number)| tells_apart(*number));
    found
        .filter(|_| equal.len() > 1)
        .map(|(name, number)| (name, number(of)))
}

/// Writes the drives' identities and the number of slaves.
pub(super) fn write(document: &mut DocumentMut, chain: &[Found]) {
    let axes = document.get_mut("axes").and_then(Item::as_array_of_tables_mut);
    let Some(axes) = axes else { return };
    let used: Vec<&Found> = drives(chain).take(axes.len()).collect();
    for (axis, drive) in axes.iter_mut().zip(&used) {
        for (key, number) in [("vendor", drive.vendor), ("product", drive.product)] {
            // The way `etherpen bus scan` shows them.
            if let Ok(value) = format!("0x{number:08x}").parse::<Value>() {
                axis.insert(key, Item::Value(value));
            }
        }
        if let Some((key, number)) = mark(drive, chain, used.len()) {
            axis.insert(key, toml_edit::value(i64::from(number)));
        }
    }
    let bus = document
        .entry("bus")
        .or_insert_with(toml_edit::table)
        .as_table_like_mut();
    let Some(bus) = bus else { return };
    bus.insert(
        "slaves",
        toml_edit::value(i64::try_from(chain.len()).unwrap_or(i64::MAX)),
    );
    comment(bus, chain);
    terminals(document, chain);
}

/// Says at each input and output of the kind's sample what is wrong with its place in this chain, instead of the sample's chain.
fn terminals(document: &mut DocumentMut, chain: &[Found]) {
    let tables = document.get_mut("io").and_then(Item::as_array_of_tables_mut);
    for table in tables.into_iter().flat_map(toml_edit::ArrayOfTables::iter_mut) {
        let misplaced = misplaced(table, chain);
        let decor = table.decor_mut();
        let comments = decor.prefix().and_then(toml_edit::RawString::as_str).unwrap_or("");
        let mut lines: Vec<String> = comments
            .lines()
            .filter(|line| !line.starts_with(SAMPLE_CHAIN))
            .map(str::to_owned)
            .collect();
        lines.extend(misplaced.map(|cause| format!("# {cause}")));
        decor.set_prefix(lines.join("\n") + "\n");
    }
}

/// What is wrong with the place of an input or output: nothing stands there, or a drive.
fn misplaced(io: &Table, chain: &[Found]) -> Option<String> {
    let place = io.get("slave").and_then(Item::as_integer)?;
    let name = io.get("name").and_then(Item::as_str)?;
    match usize::try_from(place).ok().and_then(|place| chain.get(place)) {
        None => Some(format!("{name}: the chain has no slave in place {place}")),
        Some(found) if found.is_drive => Some(format!(
            "{name}: in place {place} of the chain is a drive, {}; write the place of its terminal",
            found.printable()
        )),
        Some(_) => None,
    }
}

/// Names the chain above the number of its slaves.
fn comment(bus: &mut dyn TableLike, chain: &[Found]) {
    let places = chain.iter().enumerate();
    let lines: String = places
        .map(|(place, found)| format!("#   {place} {}\n", found.printable()))
        .collect();
    if let Some(mut key) = bus.key_mut("slaves") {
        key.leaf_decor_mut()
            .set_prefix(format!("# The chain that was found, with the places from 0:\n{lines}"));
    }
}

/// What the file and the chain do not have in common.
///
/// `text` is a configuration file that was composed for this chain.
#[must_use]
pub fn notes(text: &str, chain: &[Found]) -> Vec<String> {
    let Ok(document) = text.parse::<DocumentMut>() else {
        return Vec::new();
    };
    let tables = |name: &str| document.get(name).and_then(Item::as_array_of_tables);
    let axes = tables("axes").map_or(0, toml_edit::ArrayOfTables::len);
    let used: Vec<&Found> = drives(chain).take(axes).collect();
    let mut notes = Vec::new();
    let count = drives(chain).count();
    if count > axes {
        notes.push(format!("the chain has {count} drives; the file uses the first {axes}"));
    }
    let is_alone = |one: &Found| drives(chain).filter(|other| is_equal(one, other)).count() == 1;
    if let Some(first) = used
        .iter()
        .find(|one| !is_alone(one) && mark(one, chain, axes).is_none())
    {
        notes.push(format!(
            "nothing tells the drives {} apart: give each an alias or another number of its switches, so that exchanged cables are \
             noticed",
            first.printable()
        ));
    }
    let io = tables("io").into_iter().flat_map(toml_edit::ArrayOfTables::iter);
    notes.extend(io.filter_map(|io| misplaced(io, chain)));
    notes
}

#[cfg(test)]
mod tests {
    use super::super::{Wishes, compose};
    use super::*;
    use crate::settings::checking::check;
    use crate::settings::reading::configuration;
    use etherpen::robots::Kind;

    fn drive(serial: u32) -> Found {
        Found {
            name: "Drive".into(),
            is_drive: true,
            vendor: 0x5AFE,
            product: 0x0C0F_FEE0,
            serial,
            ..Found::default()
        }
    }

    fn terminal(name: &str) -> Found {
        Found {
            name: name.into(),
            vendor: 2,
            ..Found::default()
        }
    }

    fn composed(kind: Kind, chain: &[Found], drives: Option<usize>) -> Result<String, String> {
        let wishes = Wishes {
            drives,
            chain: chain.to_vec(),
            ..Wishes::default()
        };
        compose(kind, &wishes)
    }

    #[test]
    fn axes_get_the_drives_in_the_order_of_the_chain_whatever_is_between_them() {
        let mut odd = drive(0);
        odd.product = 7;
        let chain = [
            terminal("EK1100"),
            terminal("EL1008"),
            drive(31),
            odd,
            terminal("line\nbreak"),
            drive(30),
        ];
        let text = composed(Kind::Gantry, &chain, None).expect("a file");
        assert_eq!(check(&text), [], "{text}");
        let config = configuration(&text).expect("valid");
        let of = |axis: usize| {
            (
                config.axes[axis].vendor,
                config.axes[axis].product,
                config.axes[axis].serial,
            )
        };
        assert_eq!(
            [of(0), of(1), of(2)],
            [(0x5AFE, 0x0C0F_FEE0, 31), (0x5AFE, 7, 0), (0x5AFE, 0x0C0F_FEE0, 30)]
        );
        assert_eq!((config.bus.slaves, config.bus.drives), (6, 3));
        assert!(text.contains("#   3 Drive\n#   4 linebreak\n"), "{text}");
        assert_eq!(notes(&text, &chain), [""; 0]);
    }

    #[test]
    fn equal_drives_are_told_apart_by_what_stays_at_the_place_if_all_have_it() {
        let marked = |set: fn(&mut Found, u16)| {
            let mut chain = [drive(5), drive(6)];
            chain.iter_mut().zip(1..).for_each(|(found, number)| set(found, number));
            let config = configuration(&composed(Kind::CoreXy, &chain, Some(2)).expect("a file")).expect("valid");
            [0, 1].map(|axis| {
                let axis = &config.axes[axis];
                (axis.switch, axis.alias, axis.serial)
            })
        };
        assert_eq!(marked(|_, _| {}), [(0, 0, 5), (0, 0, 6)]);
        assert_eq!(marked(|found, number| found.alias = number), [(0, 1, 0), (0, 2, 0)]);
        assert_eq!(marked(|found, number| found.switch = number), [(1, 0, 0), (2, 0, 0)]);
        assert_eq!(marked(|found, number| found.alias = number / 2), [(0, 0, 5), (0, 0, 6)]);
        let alike = marked(|found, _| found.serial = 0);
        assert_eq!(alike, [(0, 0, 0); 2]);
    }

    #[test]
    fn a_drive_that_no_axis_uses_is_told_apart_too_but_needs_no_mark() {
        let marked = |aliases: &[u16]| {
            let with_alias = |(alias, serial): (&u16, u32)| Found {
                alias: *alias,
                ..drive(serial)
            };
            let chain: Vec<Found> = aliases.iter().zip(5..).map(with_alias).collect();
            let config = configuration(&composed(Kind::CoreXy, &chain, Some(2)).expect("a file")).expect("valid");
            [0, 1].map(|axis| (config.axes[axis].alias, config.axes[axis].serial))
        };
        // It may be plugged into the place of one that is used.
        assert_eq!(marked(&[1, 2, 2]), [(0, 5), (0, 6)]);
        assert_eq!(marked(&[1, 2, 3]), [(1, 0), (2, 0)]);
        assert_eq!(marked(&[1, 2, 0]), [(1, 0), (2, 0)]);
        assert_eq!(marked(&[1, 2, 3, 3]), [(1, 0), (2, 0)]);
    }

    #[test]
    fn no_file_for_a_chain_that_was_found_names_the_chain_of_its_sample() {
        for kind in Kind::ALL {
            let mut chain = vec![terminal("coupler"), terminal("inputs"), terminal("outputs")];
            chain.extend((1..=4).map(drive));
            let text = composed(kind, &chain, None).expect("a file");
            assert!(!text.contains("EK1100") && !text.contains("then the drives"), "{text}");
            assert_eq!(check(&text), [], "{text}");
        }
    }

    #[test]
    fn what_does_not_fit_is_told() {
        let chain = [drive(0), drive(0), drive(0), drive(0)];
        let text = composed(Kind::Gantry, &chain, None).expect("a file");
        let notes = notes(&text, &chain);
        let told = |words: &str| notes.iter().any(|note| note.contains(words));
        assert!(told("has 4 drives; the file uses the first 3"), "{notes:?}");
        assert!(told("nothing tells the drives Drive apart"), "{notes:?}");
        assert!(told("x_home: in place 1 of the chain is a drive"), "{notes:?}");
        let at_the_place = "# x_home: in place 1 of the chain is a drive, Drive; write the place of its terminal\n\
             [[io]]\nname = \"x_home\"";
        assert!(text.contains(at_the_place) && !text.contains("EK1100"), "{text}");
        assert!(text.contains("# Home switches are closed"), "{text}");
        assert!(
            super::notes(&text, &chain[..1])
                .iter()
                .any(|note| note.contains("no slave in place 1")),
            "{text}"
        );
        let refused = |chain: &[Found], drives| composed(Kind::Gantry, chain, drives).unwrap_err();
        assert!(refused(&[terminal("EK1100")], None).contains("no drive was found"));
        assert!(refused(&chain[..2], Some(3)).contains("2 drives were found"));
        assert!(refused(&chain[..2], None).contains("3 to 4 axes"));
    }
}
