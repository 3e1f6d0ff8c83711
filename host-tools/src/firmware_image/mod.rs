//! A linked firmware image: memory layout, call graph and stack depth.
//!
//! The guarantees of the critical tasks (no panic, no critical section, no log, a bounded stack) depend on the machine
//! code, so they are checked in the machine code: functions and sections from the ELF file, calls and stack from an
//! analysis of its instructions.

mod calls;
mod placement;
pub mod stm32h743;
mod thumb;

pub use calls::{CallGraph, INDIRECT_NESTING, StackBound};
pub use placement::section_pattern;

use crate::error::ProgramError;
use crate::hash::fnv1a;
use object::elf::{EM_ARM, PT_LOAD, SHF_ALLOC, SHT_ARM_ATTRIBUTES};
use object::read::elf::{ElfFile32, FileHeader, ProgramHeader, SectionHeader};
use object::{Endianness, Object, ObjectSection, ObjectSymbol, SymbolKind};
use std::fmt;
use std::path::Path;

/// Why an image cannot be read.
#[derive(Debug)]
pub enum ImageError {
    /// The file cannot be read.
    File {
        /// Its name.
        path: String,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The file is not an ELF file for a 32-bit processor.
    Format {
        /// The reason.
        reason: String,
    },
}

impl fmt::Display for ImageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File { path, source } => write!(f, "cannot read the image '{path}': {source}"),
            Self::Format { reason } => write!(f, "not a firmware image: {reason}"),
        }
    }
}

impl std::error::Error for ImageError {}

/// A function of the image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Function {
    /// Its name as linked.
    pub name: String,
    /// Address of its first instruction.
    pub address: u32,
    /// Its length, bytes.
    pub size: u32,
}

/// A section with an address.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Section {
    /// Its name.
    pub name: String,
    /// Address of its first byte when the program runs.
    pub address: u32,
    /// Its length, bytes.
    pub size: u32,
    data: Vec<u8>,
}

impl Section {
    /// Whether the section contains an address.
    #[must_use]
    pub fn contains(&self, address: u32) -> bool {
        address
            .checked_sub(self.address)
            .is_some_and(|offset| offset < self.size)
    }
}

/// Prefix of the names of the functions that the linker generates for branches beyond the range of an instruction: they
/// load the address of the function whose name follows into r12 and jump there.
pub const LONG_BRANCH: &str = "__Thumbv7ABSLongThunk_";
/// Length of MOVW, MOVT and BX; the linker gives no length.
const LONG_BRANCH_BYTES: u32 = 10;

/// A parsed image.
#[derive(Clone, Debug)]
pub struct Image {
    sections: Vec<Section>,
    /// In the order of their addresses; of several names for one address, the first.
    functions: Vec<Function>,
    symbols: Vec<Function>,
    /// Addresses at which data begin within code, and at which code begins again.
    code_begins: Vec<(u32, bool)>,
    loads: Vec<Load>,
    attributes: Vec<u8>,
}

/// A part of the image that is written into the flash memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Load {
    /// Address of its first byte in the flash memory.
    pub address: u32,
    /// Its length, bytes.
    pub size: u32,
}

impl Image {
    /// Reads an ELF file.
    ///
    /// # Errors
    /// [`ImageError`] for a file that cannot be read or is not an image.
    pub fn read(path: &Path) -> Result<Self, ImageError> {
        let bytes = std::fs::read(path).map_err(|source| ImageError::File {
            path: path.display().to_string(),
            source,
        })?;
        Self::parse(&bytes)
    }

    /// Reads an ELF file's bytes.
    ///
    /// # Errors
    /// [`ImageError::Format`].
    pub fn parse(bytes: &[u8]) -> Result<Self, ImageError> {
        let format = |error: object::Error| ImageError::Format {
            reason: error.to_string(),
        };
        let file = ElfFile32::<Endianness>::parse(bytes).map_err(format)?;
        let endian = file.endian();
        let machine = file.elf_header().e_machine(endian);
        if machine != EM_ARM {
            return Err(ImageError::Format {
                reason: format!(
                    "it is for another processor (ELF machine {}, an Arm has {})",
                    machine, EM_ARM
                ),
            });
        }
        let mut sections = Vec::new();
        let mut attributes = Vec::new();
        for section in file.sections() {
            let name = section.name().map_err(format)?.to_owned();
            let data = section.data().map_err(format)?.to_vec();
            if section.elf_section_header().sh_type(endian) == SHT_ARM_ATTRIBUTES {
                attributes = data;
            } else if section.elf_section_header().sh_flags(endian) & SHF_ALLOC != 0 {
                sections.push(Section {
                    name,
                    address: section.address() as u32,
                    size: section.size() as u32,
                    data,
                });
            }
        }
        let loads = file
            .elf_program_headers()
            .iter()
            .filter(|header| header.p_type(endian) == PT_LOAD && header.p_filesz(endian) > 0)
            .map(|header| Load {
                address: header.p_paddr(endian),
                size: header.p_filesz(endian),
            })
            .collect();
        let (functions, symbols, code_begins) = symbols(&file);
        Ok(Self {
            sections,
            functions,
            symbols,
            code_begins,
            loads,
            attributes,
        })
    }

    /// Bytes that are written into the flash memory.
    #[must_use]
    pub fn flash_bytes(&self) -> u32 {
        self.loads.iter().fold(0, |sum, load| sum.saturating_add(load.size))
    }

    /// The parts that are written into the flash memory.
    #[must_use]
    pub fn loads(&self) -> &[Load] {
        &self.loads
    }

    /// A section by its name.
    #[must_use]
    pub fn section(&self, name: &str) -> Option<&Section> {
        self.sections.iter().find(|section| section.name == name)
    }

    /// All sections that have an address.
    #[must_use]
    pub fn sections(&self) -> &[Section] {
        &self.sections
    }

    /// Every name for an address, functions or data.
    #[must_use]
    pub fn symbols(&self) -> &[Function] {
        &self.symbols
    }

    /// The functions, in the order of their addresses.
    #[must_use]
    pub fn functions(&self) -> &[Function] {
        &self.functions
    }

    /// The function with a name; a task's name is that of its interrupt.
    #[must_use]
    pub fn function(&self, name: &str) -> Option<&Function> {
        let named = self.symbols.iter().find(|symbol| symbol.name == name)?;
        self.function_at(named.address)
    }

    /// The function that contains an address.
    #[must_use]
    pub fn function_at(&self, address: u32) -> Option<&Function> {
        let index = self.functions.partition_point(|function| function.address <= address);
        let function = self.functions.get(index.checked_sub(1)?)?;
        (address - function.address < function.size).then_some(function)
    }

    /// Whether the code may use double-precision instructions of an ARMv8-M or Cortex-M7 floating-point unit: the build
    /// attribute `Tag_FP_arch` (6 in the public part) is FPv5 with 16 double registers.
    #[must_use]
    pub fn has_double_precision(&self) -> bool {
        attribute(&self.attributes, TAG_FP_ARCH) == Some(FP_ARMV8_16)
    }

    /// The halfword at an address.
    fn halfword(&self, address: u32) -> Option<u16> {
        let section = self.sections.iter().find(|section| section.contains(address))?;
        let offset = (address - section.address) as usize;
        let bytes = section.data.get(offset..offset.checked_add(2)?)?;
        Some(u16::from_le_bytes([*bytes.first()?, *bytes.get(1)?]))
    }

    /// The word at an address of the running program; `None` if the image has no content there.
    #[must_use]
    pub fn word(&self, address: u32) -> Option<u32> {
        let low = self.halfword(address)?;
        let high = self.halfword(address.checked_add(2)?)?;
        Some(u32::from(high) << 16 | u32::from(low))
    }

    /// Whether an address within a function contains an instruction and not data.
    fn is_code(&self, address: u32) -> bool {
        let index = self.code_begins.partition_point(|(begin, _)| *begin <= address);
        index
            .checked_sub(1)
            .and_then(|index| self.code_begins.get(index))
            .is_none_or(|(_, code)| *code)
    }
}

type Symbols = (Vec<Function>, Vec<Function>, Vec<(u32, bool)>);

/// Functions, all names, and where code and data begin (mapping symbols of the ARM ELF format).
fn symbols(file: &ElfFile32<'_>) -> Symbols {
    let (mut functions, mut names, mut begins) = (Vec::new(), Vec::new(), Vec::new());
    for symbol in file.symbols() {
        let Ok(name) = symbol.name() else { continue };
        // The lowest bit of a function's address marks Thumb code.
        let address = symbol.address() as u32 & !1;
        match name {
            "$t" => begins.push((address, true)),
            "$d" => begins.push((address, false)),
            _ => {}
        }
        if name.is_empty() || name.starts_with('$') || symbol.is_undefined() {
            continue;
        }
        let entry = Function {
            name: name.to_owned(),
            address: if symbol.kind() == SymbolKind::Text {
                address
            } else {
                symbol.address() as u32
            },
            size: match symbol.size() as u32 {
                0 if name.starts_with(LONG_BRANCH) => LONG_BRANCH_BYTES,
                size => size,
            },
        };
        if symbol.kind() == SymbolKind::Text && entry.size > 0 {
            functions.push(entry.clone());
        }
        names.push(entry);
    }
    functions.sort_by_key(|function| function.address);
    functions.dedup_by_key(|function| function.address);
    begins.sort_unstable();
    (functions, names, begins)
}

/// "Addenda to, and Errata in, the ABI for the Arm Architecture", public tags.
const TAG_FP_ARCH: u8 = 10;
/// FPv5 (ARMv8 FP) with 16 double-precision registers.
const FP_ARMV8_16: u64 = 8;
/// Tags 4, 5 and 67 are strings; all other tags in use are at most 127.
const TEXT_TAGS: [u8; 3] = [4, 5, 67];
/// Format version, length, `aeabi` and its end, tag and length of the file's part.
const ATTRIBUTES_HEADER: usize = 1 + 4 + 6 + 1 + 4;

/// The value of a build attribute of the whole file.
fn attribute(section: &[u8], wanted: u8) -> Option<u64> {
    let mut bytes = section.get(ATTRIBUTES_HEADER..)?.iter().copied();
    loop {
        let tag = bytes.next()?;
        if TEXT_TAGS.contains(&tag) {
            bytes.by_ref().take_while(|byte| *byte != 0).for_each(drop);
            continue;
        }
        let mut value = 0u64;
        for shift in (0..u64::BITS).step_by(7) {
            let byte = bytes.next()?;
            value |= u64::from(byte & 0x7F) << shift;
            if byte & 0x80 == 0 {
                break;
            }
        }
        if tag == wanted {
            return Some(value);
        }
    }
}

/// Hash of a firmware image: FNV-1a, 64 bits, over the file.
///
/// # Errors
/// The image cannot be read.
pub fn image_hash(image: &Path) -> Result<String, ProgramError> {
    let bytes = std::fs::read(image)
        .map_err(|cause| ProgramError::failed(format!("the image {} cannot be read", image.display()), cause))?;
    Ok(format!("fnv1a64:{:016x}", fnv1a(bytes)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_image_is_refused() {
        for bytes in [&b""[..], b"\x7fELF", &[0; 4096]] {
            assert!(matches!(Image::parse(bytes), Err(ImageError::Format { .. })));
        }
    }

    #[test]
    fn an_attribute_is_found_behind_texts_and_long_values() {
        let mut section = vec![b'A', 0, 0, 0, 0];
        section.extend_from_slice(b"aeabi\0\x01\0\0\0\0");
        section.extend_from_slice(b"\x43AAPCS\0\x05name\0\x06\x85\x01\x0a\x08");
        assert_eq!(attribute(&section, 6), Some(133));
        assert_eq!(attribute(&section, TAG_FP_ARCH), Some(FP_ARMV8_16));
        assert_eq!(attribute(&section, 9), None);
        assert_eq!(attribute(&[], 9), None);
    }
}
