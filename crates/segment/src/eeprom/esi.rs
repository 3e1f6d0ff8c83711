//! EtherCAT slave information files (ESI, XML): an information memory and an object dictionary from one device in them.
//!
//! Taken from the file: vendor, product and revision, names, ports, current, FMMUs, sync managers, mailboxes with their
//! protocols and those of BOOT, PDOs, modes of the distributed clock, the configuration words, and the dictionary with
//! data types, defaults and access rights. Modules and slots are not read. Format: ETG.2000.
//!
//! Invariant: no file can cause a panic or an endless loop; what cannot be understood is left out, or is an error.

use crate::eeprom::sii::{self, ClockMode, Description, NOT_ASSIGNED, PdoDescription};
use crate::eeprom::windows::{SyncManagerDefault, Windows};
use crate::mailbox::dictionary::{Content, DataType, Object, ObjectCode, ObjectEntry, access};
use crate::mailbox::process_data::{Pdo, PdoEntry};
use etherpen_ethercat::wire::sii::{
    COE_COMPLETE_ACCESS, COE_PDO_ASSIGN, COE_PDO_CONFIGURE, COE_SDO, COE_SDO_INFORMATION, COE_UPLOAD_AT_START,
    Identity, MailboxWindow, PROTOCOL_COE, PROTOCOL_EOE, PROTOCOL_FOE, PROTOCOL_SOE, PROTOCOL_VOE, WORD_CHECKSUM,
    checksum,
};
use roxmltree::{Document, Node};
use std::fmt;

/// English, of the names that come in several languages.
const ENGLISH: &str = "1033";
/// Most entries of one object.
const ENTRIES_MAX: u32 = 255;
/// Longest value of an object, bytes.
const VALUE_BYTES_MAX: usize = 64 * 1024;
/// Indices that follow from the PDOs, their sync managers and the identity in every device.
const DERIVED: [std::ops::Range<u16>; 3] = [0x1018..0x1019, 0x1600..0x1C01, 0x1C12..0x1C14];
/// Configuration of a device with a processor if the file has none: 8-bit parallel interface, clock units powered.
const CONFIGURATION_DEFAULT: u16 = 0x0C08;

/// A device from an ESI file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EsiDevice {
    name: String,
    image: Vec<u8>,
    objects: Vec<Object>,
}

/// Why no device could be read from a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum EsiError {
    /// The text is not XML.
    Xml {
        /// What is wrong, and where.
        reason: String,
    },
    /// The file has no such device.
    Device {
        /// The devices in the file: type, product code and revision.
        known: Vec<String>,
    },
    /// The vendor's number is missing or malformed.
    Vendor,
}

impl fmt::Display for EsiError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Xml { reason } => write!(formatter, "not XML: {reason}"),
            Self::Device { known } if known.is_empty() => formatter.write_str("it describes no device"),
            Self::Device { known } => write!(formatter, "it has no such device, but {}", known.join(", ")),
            Self::Vendor => formatter.write_str("the vendor's number is missing"),
        }
    }
}

impl std::error::Error for EsiError {}

impl EsiDevice {
    /// Reads a device: the one with this type (`EL1008`), product code (`0x03F03052`) or type or code and revision
    /// (`EL1008:0x00110000`); of several, the one with the highest revision. `None` takes the first device.
    ///
    /// # Errors
    /// [`EsiError`].
    pub fn parse(text: &str, wanted: Option<&str>) -> Result<Self, EsiError> {
        let document = Document::parse(text).map_err(|error| EsiError::Xml {
            reason: error.to_string(),
        })?;
        let root = document.root_element();
        let devices: Vec<Node> = root.descendants().filter(|node| node.has_tag_name("Device")).collect();
        let matching = devices
            .iter()
            .filter(|device| wanted.is_none_or(|wanted| is_wanted(**device, wanted)));
        let device = match wanted {
            None => matching.min_by_key(|_| 0),
            Some(_) => matching.max_by_key(|device| revision(**device)),
        };
        let Some(device) = device else {
            return Err(EsiError::Device {
                known: devices.iter().map(|device| shown(*device)).collect(),
            });
        };
        let vendor = child(root, "Vendor").and_then(|vendor| child_number(vendor, "Id"));
        Ok(Self::read(*device, vendor.ok_or(EsiError::Vendor)?))
    }

    /// The device's name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The information memory.
    pub(crate) fn image(&self) -> &[u8] {
        &self.image
    }

    /// The objects that do not follow from the information memory.
    pub(crate) fn objects(&self) -> &[Object] {
        &self.objects
    }

    fn read(device: Node, vendor: u32) -> Self {
        let kind = child(device, "Type");
        let order = kind.map(text).unwrap_or_default();
        let name = english(device).unwrap_or_else(|| order.clone());
        let attribute = |name| kind.and_then(|kind| kind.attribute(name)).and_then(number).unwrap_or(0);
        let managers = sync_managers(device);
        let memory = child(device, "Eeprom");
        let configuration = memory
            .and_then(|memory| child_bytes(memory, "ConfigData"))
            .unwrap_or_default();
        let fmmus: Vec<u8> = children(device, "Fmmu").map(|fmmu| fmmu_use(&text(fmmu))).collect();
        let clocks = clock_modes(device);
        let mailbox = child(device, "Mailbox");
        let mut image = sii::image(&Description {
            identity: Identity {
                vendor,
                product: attribute("ProductCode"),
                revision: attribute("RevisionNo"),
                serial: attribute("SerialNo"),
            },
            name: &name,
            order: &order,
            configuration: match configuration.first_chunk() {
                Some(bytes) => u16::from_le_bytes(*bytes),
                None => CONFIGURATION_DEFAULT,
            },
            windows: windows(&managers, mailbox, memory),
            details: details(mailbox),
            current_ma: child(device, "Info")
                .and_then(|info| child(info, "Electrical"))
                .and_then(|electrical| child_number(electrical, "EBusCurrent"))
                .map_or(0, |current| current as i16),
            fmmus: &fmmus,
            pdos: pdos(device, &managers),
            sync_managers: managers,
            has_sync_units: false,
            ports: ports(device.attribute("Physics").unwrap_or("YY")),
            clocks: &clocks,
        });
        configure(&mut image, &configuration);
        Self {
            name,
            image,
            objects: objects(device),
        }
    }
}

fn is_wanted(device: Node, wanted: &str) -> bool {
    let (kind, wanted_revision) = match wanted.split_once(':') {
        Some((kind, revision)) => (kind, number(revision)),
        None => (wanted, None),
    };
    let Some(node) = child(device, "Type") else {
        return false;
    };
    let product = node.attribute("ProductCode").and_then(number);
    (text(node).eq_ignore_ascii_case(kind) || product.is_some() && product == number(kind))
        && wanted_revision.is_none_or(|wanted| wanted == revision(device))
}

fn revision(device: Node) -> u32 {
    let kind = child(device, "Type");
    kind.and_then(|kind| kind.attribute("RevisionNo"))
        .and_then(number)
        .unwrap_or(0)
}

fn shown(device: Node) -> String {
    let kind = child(device, "Type");
    let product = kind.and_then(|kind| kind.attribute("ProductCode")).and_then(number);
    let name = kind.map(text).unwrap_or_default();
    format!("{name} ({:#010x}:{:#010x})", product.unwrap_or(0), revision(device))
}

/// Writes the configuration words, and their checksum.
fn configure(image: &mut [u8], configuration: &[u8]) {
    let place = 2 * usize::from(WORD_CHECKSUM);
    for (target, source) in image.iter_mut().take(place).zip(configuration) {
        *target = *source;
    }
    let sum = image.get(..place).map(checksum);
    if let (Some(target), Some(sum)) = (image.get_mut(place), sum) {
        *target = sum;
    }
}

fn fmmu_use(text: &str) -> u8 {
    match text {
        "Outputs" => 1,
        "Inputs" => 2,
        "MBoxState" => 3,
        _ => 0,
    }
}

/// Kind of each port, two bits each: Y is MII, K is EBUS.
fn ports(physics: &str) -> u8 {
    let ports = physics.chars().take(4).map(|port| match port {
        'Y' | 'H' => 3,
        'K' => 2,
        _ => 0,
    });
    ports.enumerate().fold(0, |all, (port, kind)| all | kind << (2 * port))
}

fn sync_managers(device: Node) -> Vec<SyncManagerDefault> {
    let managers = children(device, "Sm").map(|manager| {
        let field = |name| manager.attribute(name).and_then(number).unwrap_or(0);
        SyncManagerDefault {
            start: field("StartAddress") as u16,
            length: field("DefaultSize") as u16,
            control: field("ControlByte") as u8,
            activate: field("Enable") as u8,
            kind: match text(manager).as_str() {
                "MBoxOut" => 1,
                "MBoxIn" => 2,
                "Outputs" => 3,
                "Inputs" => 4,
                _ => 0,
            },
        }
    });
    managers.collect()
}

fn windows(managers: &[SyncManagerDefault], mailbox: Option<Node>, memory: Option<Node>) -> Windows {
    let of_kind = |kind| managers.iter().find(move |manager| manager.kind == kind);
    let window = |kind| {
        let manager = of_kind(kind).filter(|_| mailbox.is_some());
        manager.map_or(MailboxWindow::default(), |manager| MailboxWindow {
            start: manager.start,
            length: manager.length,
        })
    };
    let bootstrap = memory
        .and_then(|memory| child_bytes(memory, "BootStrap"))
        .unwrap_or_default();
    let bootstrap = |at: usize| match bootstrap.get(at..).and_then(|rest| rest.first_chunk()) {
        Some(&[start_low, start_high, length_low, length_high]) => MailboxWindow {
            start: u16::from_le_bytes([start_low, start_high]),
            length: u16::from_le_bytes([length_low, length_high]),
        },
        None => MailboxWindow::default(),
    };
    let protocols = [
        ("EoE", PROTOCOL_EOE),
        ("CoE", PROTOCOL_COE),
        ("FoE", PROTOCOL_FOE),
        ("SoE", PROTOCOL_SOE),
        ("VoE", PROTOCOL_VOE),
    ];
    let spoken = protocols
        .into_iter()
        .filter(|(name, _)| mailbox.is_some_and(|mailbox| child(mailbox, name).is_some()));
    Windows {
        mailbox_out: window(1),
        mailbox_in: window(2),
        outputs: of_kind(3).map_or(0, |manager| manager.start),
        inputs: of_kind(4).map_or(0, |manager| manager.start),
        protocols: spoken.fold(0, |protocols, (_, bit)| protocols | bit),
        bootstrap_out: bootstrap(0),
        bootstrap_in: bootstrap(4),
    }
}

/// Details of CANopen over EtherCAT, as in the general category.
fn details(mailbox: Option<Node>) -> u8 {
    let Some(coe) = mailbox.and_then(|mailbox| child(mailbox, "CoE")) else {
        return 0;
    };
    let flags = [
        ("SdoInfo", COE_SDO_INFORMATION),
        ("PdoAssign", COE_PDO_ASSIGN),
        ("PdoConfig", COE_PDO_CONFIGURE),
        ("PdoUpload", COE_UPLOAD_AT_START),
        ("CompleteAccess", COE_COMPLETE_ACCESS),
    ];
    let set = flags
        .into_iter()
        .filter(|(name, _)| coe.attribute(*name).is_some_and(is_true));
    set.fold(COE_SDO, |details, (_, bit)| details | bit)
}

fn clock_modes(device: Node) -> Vec<ClockMode> {
    let Some(clock) = child(device, "Dc") else {
        return Vec::new();
    };
    let modes = children(clock, "OpMode").map(|mode| {
        let factor = |name| {
            child(mode, name)
                .and_then(|node| node.attribute("Factor"))
                .and_then(signed)
                .unwrap_or(0)
        };
        ClockMode {
            name: child(mode, "Name").map(text).unwrap_or_default(),
            activate: child_number(mode, "AssignActivate").unwrap_or(0) as u16,
            cycle_ns: child_number(mode, "CycleTimeSync0").unwrap_or(0),
            factor: factor("CycleTimeSync0") as i16,
            shift_ns: child_number(mode, "ShiftTimeSync0").unwrap_or(0),
            factor_1: factor("CycleTimeSync1") as i16,
            shift_1_ns: child_number(mode, "ShiftTimeSync1").unwrap_or(0),
        }
    });
    modes.take(usize::from(u8::MAX) - 3).collect()
}

fn pdos(device: Node, managers: &[SyncManagerDefault]) -> Vec<PdoDescription> {
    let listed = device
        .children()
        .filter(|node| node.has_tag_name("RxPdo") || node.has_tag_name("TxPdo"));
    let pdos = listed.filter_map(|node| {
        let entries: Vec<PdoEntry> = children(node, "Entry").filter_map(pdo_entry).collect();
        let index = u16::try_from(child_number(node, "Index")?).ok()?;
        let manager = node
            .attribute("Sm")
            .and_then(number)
            .and_then(|manager| u8::try_from(manager).ok());
        let exists = |manager: &u8| usize::from(*manager) < managers.len();
        Some(PdoDescription {
            pdo: Pdo::new(
                index,
                &english(node).unwrap_or_default(),
                node.attribute("Fixed").is_some_and(is_true),
                &entries,
            ),
            manager: manager.filter(exists).unwrap_or(NOT_ASSIGNED),
            mandatory: node.attribute("Mandatory").is_some_and(is_true),
        })
    });
    pdos.collect()
}

fn pdo_entry(node: Node) -> Option<PdoEntry> {
    Some(PdoEntry {
        index: child_number(node, "Index")? as u16,
        sub: child_number(node, "SubIndex").unwrap_or(0) as u8,
        bits: u8::try_from(child_number(node, "BitLen")?).ok()?,
    })
}

fn objects(device: Node) -> Vec<Object> {
    let Some(dictionary) = child(device, "Profile").and_then(|profile| child(profile, "Dictionary")) else {
        return Vec::new();
    };
    let types: Vec<Node> = child(dictionary, "DataTypes")
        .map(|types| children(types, "DataType").collect())
        .unwrap_or_default();
    let mut objects: Vec<Object> = child(dictionary, "Objects")
        .map(|objects| {
            children(objects, "Object")
                .filter_map(|node| object(node, &types))
                .collect()
        })
        .unwrap_or_default();
    objects.sort_by_key(|object| object.index);
    objects.dedup_by_key(|object| object.index);
    objects
}

fn object(node: Node, types: &[Node]) -> Option<Object> {
    let index = u16::try_from(child_number(node, "Index")?).ok()?;
    if DERIVED.iter().any(|range| range.contains(&index)) {
        return None;
    }
    let name = english(node).unwrap_or_default();
    let kind = child(node, "Type").map(text).unwrap_or_default();
    let declared = find_type(types, &kind);
    let parts: Vec<Node> = declared
        .map(|kind| children(kind, "SubItem").collect())
        .unwrap_or_default();
    let info = child(node, "Info");
    if parts.is_empty() {
        let bits = child_number(node, "BitSize").unwrap_or(0);
        let entry = entry(0, &name, &kind, bits, access_of(&[node]), default_of(info));
        return Some(Object {
            index,
            name,
            code: ObjectCode::Variable,
            entries: vec![entry],
        });
    }
    let values: Vec<Node> = info.map(|info| children(info, "SubItem").collect()).unwrap_or_default();
    let mut entries: Vec<ObjectEntry> = Vec::new();
    let mut is_array = false;
    for part in parts {
        let part_name = child(part, "Name").map(text).unwrap_or_default();
        let part_type = child(part, "Type").map(text).unwrap_or_default();
        let access = access_of(&[part, node]);
        let elements = find_type(types, &part_type).and_then(|kind| Some((kind, child(kind, "ArrayInfo")?)));
        let (first, count, kind, bits) = match (child_number(part, "SubIdx"), elements) {
            (None, Some((kind, array))) => {
                is_array = true;
                let count = child_number(array, "Elements").unwrap_or(0).min(ENTRIES_MAX);
                let bits = child_number(kind, "BitSize")
                    .unwrap_or(0)
                    .checked_div(count)
                    .unwrap_or(0);
                let base = child(kind, "BaseType").map(text).unwrap_or_default();
                (child_number(array, "LBound").unwrap_or(1), count, base, bits)
            }
            (sub, _) => {
                let next = entries.last().map_or(0, |entry| u32::from(entry.sub) + 1);
                (
                    sub.unwrap_or(next),
                    1,
                    part_type,
                    child_number(part, "BitSize").unwrap_or(0),
                )
            }
        };
        for sub in first..first.saturating_add(count) {
            let Ok(sub) = u8::try_from(sub) else { break };
            if entries.last().is_some_and(|entry| entry.sub >= sub) {
                continue;
            }
            let value = values.get(entries.len()).and_then(|value| child(*value, "Info"));
            entries.push(entry(sub, &part_name, &kind, bits, access, default_of(value)));
        }
    }
    let code = if is_array {
        ObjectCode::Array
    } else {
        ObjectCode::Record
    };
    Some(Object {
        index,
        name,
        code,
        entries,
    })
}

fn find_type<'a, 'input>(types: &[Node<'a, 'input>], name: &str) -> Option<Node<'a, 'input>> {
    types
        .iter()
        .copied()
        .find(|kind| child(*kind, "Name").is_some_and(|node| text(node) == name))
}

/// A default value: bytes as they are transferred, or a number.
enum Default {
    Bytes(Vec<u8>),
    Number(i64),
    Text(String),
}

fn default_of(info: Option<Node>) -> Option<Default> {
    let info = info?;
    if let Some(bytes) = child_bytes(info, "DefaultData") {
        return Some(Default::Bytes(bytes));
    }
    if let Some(string) = child(info, "DefaultString") {
        return Some(Default::Text(text(string)));
    }
    let value = text(child(info, "DefaultValue")?);
    Some(signed(&value).map_or(Default::Text(value), Default::Number))
}

fn entry(sub: u8, name: &str, kind: &str, bits: u32, access: u16, default: Option<Default>) -> ObjectEntry {
    let length = usize::try_from(bits.div_ceil(8)).unwrap_or(0).min(VALUE_BYTES_MAX);
    let kind = data_type(kind, length);
    let mut value = match default {
        Some(Default::Bytes(bytes)) => bytes,
        Some(Default::Number(number)) => number.to_le_bytes().to_vec(),
        Some(Default::Text(text)) => text.into_bytes(),
        None => Vec::new(),
    };
    let is_text = kind == DataType::VisibleString;
    match kind.bytes() {
        Some(bytes) => value.resize(bytes, 0),
        None if is_text => value.truncate(length.max(1)),
        None => value.resize(length, 0),
    }
    let content = match (access & access::WRITE != 0, kind.bytes()) {
        (false, _) => Content::Fixed(value),
        (true, None) => Content::Bytes { longest: length, value },
        (true, Some(_)) => Content::Number {
            value: kind.decode(&value).unwrap_or(0),
            low: i64::MIN,
            high: i64::MAX,
        },
    };
    ObjectEntry {
        sub,
        name: name.to_owned(),
        kind,
        access,
        content,
    }
}

/// The type with a name; one of another name is that of its length in bytes.
fn data_type(name: &str, length: usize) -> DataType {
    match name {
        "BOOL" => DataType::Boolean,
        "SINT" => DataType::Integer8,
        "INT" => DataType::Integer16,
        "DINT" => DataType::Integer32,
        "LINT" => DataType::Integer64,
        "REAL" => DataType::Real32,
        "LREAL" => DataType::Real64,
        name if name.starts_with("STRING") => DataType::VisibleString,
        _ => match length {
            1 => DataType::Unsigned8,
            2 => DataType::Unsigned16,
            4 => DataType::Unsigned32,
            8 => DataType::Unsigned64,
            _ => DataType::OctetString,
        },
    }
}

/// Access rights from the first of these nodes that tells them; read only without any.
fn access_of(nodes: &[Node]) -> u16 {
    let flags = nodes
        .iter()
        .find_map(|node| child(*node, "Flags").filter(|flags| child(*flags, "Access").is_some()));
    let Some(flags) = flags else {
        return access::READ;
    };
    let node = child(flags, "Access");
    let rights = node.map(text).unwrap_or_default();
    let restricted = node.and_then(|node| node.attribute("WriteRestrictions"));
    let write = match restricted {
        Some("PreOP" | "PreOp") => access::WRITE_PREOP,
        Some("PreOP_SafeOP" | "PreOp_SafeOp") => access::WRITE_PREOP | access::WRITE_PREOP << 1,
        _ => access::WRITE,
    };
    let mapping = child(flags, "PdoMapping")
        .map(text)
        .unwrap_or_default()
        .to_ascii_uppercase();
    let allowed = |letter, bit| if mapping.contains(letter) { bit } else { 0 };
    let transfer = match rights.as_str() {
        "wo" => write,
        "rw" => access::READ | write,
        _ => access::READ,
    };
    transfer | allowed('R', access::RX) | allowed('T', access::TX)
}

fn child<'a, 'input>(node: Node<'a, 'input>, name: &str) -> Option<Node<'a, 'input>> {
    node.children().find(|node| node.has_tag_name(name))
}

fn children<'a, 'input>(node: Node<'a, 'input>, name: &'static str) -> impl Iterator<Item = Node<'a, 'input>> {
    node.children().filter(move |node| node.has_tag_name(name))
}

fn text(node: Node) -> String {
    node.text().unwrap_or_default().trim().to_owned()
}

/// A node's name, the English one if there are several.
fn english(node: Node) -> Option<String> {
    let names = || children(node, "Name");
    let english = names().find(|name| name.attribute("LcId") == Some(ENGLISH));
    english.or_else(|| names().next()).map(text)
}

fn child_number(node: Node, name: &str) -> Option<u32> {
    number(&text(child(node, name)?))
}

fn child_bytes(node: Node, name: &str) -> Option<Vec<u8>> {
    let digits: Vec<char> = text(child(node, name)?)
        .chars()
        .filter(|digit| !digit.is_whitespace())
        .collect();
    let pairs = digits
        .chunks(2)
        .map(|pair| u8::from_str_radix(&pair.iter().collect::<String>(), 16).ok());
    pairs.collect()
}

/// A number, decimal or hexadecimal behind `#x` or `0x`; a negative one as its two's complement.
fn number(text: &str) -> Option<u32> {
    signed(text).and_then(|number| match number {
        0.. => u32::try_from(number).ok(),
        _ => i32::try_from(number).ok().map(i32::cast_unsigned),
    })
}

fn signed(text: &str) -> Option<i64> {
    let text = text.trim();
    match text.strip_prefix("#x").or(text.strip_prefix("0x")) {
        Some(digits) => u64::from_str_radix(digits, 16).ok().map(u64::cast_signed),
        None => text.parse().ok(),
    }
}

fn is_true(text: &str) -> bool {
    matches!(text.trim(), "1" | "true")
}

#[cfg(test)]
mod tests;
