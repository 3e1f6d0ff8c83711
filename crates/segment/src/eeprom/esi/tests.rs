//! A small file with the parts that real ones have, and damaged ones.

use super::*;
use crate::eeprom::content::Content as Image;

pub(crate) const FILE: &str = r##"<?xml version="1.0"?>
<EtherCATInfo><Vendor><Id>#x0E7E</Id><Name>Example</Name></Vendor><Descriptions><Devices>
<Device Physics="YY"><Type ProductCode="#x00000100" RevisionNo="1">IO-1</Type><Name LcId="1033">Old</Name></Device>
<Device Physics="YY"><Type ProductCode="#x00000100" RevisionNo="#x00020000">IO-1</Type>
<Name LcId="1031">Klemme</Name><Name LcId="1033">Mixed terminal</Name>
<Info><Electrical><EBusCurrent>-130</EBusCurrent></Electrical></Info>
<Profile><Dictionary><DataTypes>
<DataType><Name>UINT</Name><BitSize>16</BitSize></DataType>
<DataType><Name>DT8000ARR</Name><BaseType>INT</BaseType><BitSize>32</BitSize>
<ArrayInfo><LBound>1</LBound><Elements>2</Elements></ArrayInfo></DataType>
<DataType><Name>DT8000</Name><BitSize>48</BitSize>
<SubItem><SubIdx>0</SubIdx><Name>SubIndex 000</Name><Type>USINT</Type><BitSize>8</BitSize>
<Flags><Access>ro</Access></Flags></SubItem>
<SubItem><Name>Elements</Name><Type>DT8000ARR</Type><BitSize>32</BitSize><BitOffs>16</BitOffs>
<Flags><Access WriteRestrictions="PreOP">rw</Access></Flags></SubItem></DataType>
</DataTypes><Objects>
<Object><Index>#x1000</Index><Name>Device type</Name><Type>UDINT</Type><BitSize>32</BitSize>
<Info><DefaultData>89130200</DefaultData></Info><Flags><Access>ro</Access></Flags></Object>
<Object><Index>#x1008</Index><Name>Name</Name><Type>STRING(4)</Type><BitSize>32</BitSize>
<Info><DefaultString>IO-1</DefaultString></Info><Flags><Access>ro</Access></Flags></Object>
<Object><Index>#x2000</Index><Name>Limit</Name><Type>INT</Type><BitSize>16</BitSize>
<Info><DefaultValue>-5</DefaultValue></Info><Flags><Access>rw</Access><PdoMapping>T</PdoMapping></Flags></Object>
<Object><Index>#x8000</Index><Name>Settings</Name><Type>DT8000</Type><BitSize>48</BitSize><Info>
<SubItem><Name>SubIndex 000</Name><Info><DefaultData>02</DefaultData></Info></SubItem>
<SubItem><Name>1</Name><Info><DefaultData>0700</DefaultData></Info></SubItem>
<SubItem><Name>2</Name><Info><DefaultData>F8FF</DefaultData></Info></SubItem></Info></Object>
</Objects></Dictionary></Profile>
<Fmmu>Outputs</Fmmu><Fmmu>Inputs</Fmmu>
<Sm MinSize="34" MaxSize="128" DefaultSize="128" StartAddress="#x1000" ControlByte="#x26" Enable="1">MBoxOut</Sm>
<Sm MinSize="34" MaxSize="128" DefaultSize="128" StartAddress="#x1080" ControlByte="#x22" Enable="1">MBoxIn</Sm>
<Sm DefaultSize="2" StartAddress="#x1100" ControlByte="#x64" Enable="1">Outputs</Sm>
<Sm DefaultSize="2" StartAddress="#x1180" ControlByte="#x20" Enable="1">Inputs</Sm>
<RxPdo Fixed="1" Sm="2"><Index>#x1600</Index><Name>Out</Name>
<Entry><Index>#x7000</Index><SubIndex>1</SubIndex><BitLen>16</BitLen><Name>Value</Name><DataType>UINT</DataType></Entry>
</RxPdo>
<TxPdo Fixed="1" Mandatory="1" Sm="3"><Index>#x1A00</Index><Name>In</Name>
<Entry><Index>#x6000</Index><SubIndex>1</SubIndex><BitLen>1</BitLen><Name>On</Name><DataType>BOOL</DataType></Entry>
<Entry><Index>0</Index><BitLen>15</BitLen></Entry></TxPdo>
<Mailbox><CoE SdoInfo="1" CompleteAccess="true" PdoAssign="0"/><FoE/></Mailbox>
<Dc><OpMode><Name>DC</Name><AssignActivate>#x0300</AssignActivate><CycleTimeSync0 Factor="1">0</CycleTimeSync0>
<ShiftTimeSync0>2000</ShiftTimeSync0></OpMode></Dc>
<Eeprom><ByteSize>2048</ByteSize><ConfigData>080E03440A000000</ConfigData><BootStrap>0010800080108000</BootStrap></Eeprom>
</Device></Devices></Descriptions></EtherCATInfo>"##;

fn device() -> EsiDevice {
    EsiDevice::parse(FILE, Some("IO-1")).expect("a device")
}

#[test]
fn the_information_memory_says_what_the_file_says() {
    let device = device();
    assert_eq!(device.name(), "Mixed terminal");
    let image = Image::parse(device.image());
    let identity = image.fixed.identity;
    assert_eq!(
        (identity.vendor, identity.product, identity.revision),
        (0x0E7E, 0x100, 0x0002_0000)
    );
    assert_eq!(image.name, "Mixed terminal");
    assert_eq!(
        (image.fixed.mailbox_out.start, image.fixed.mailbox_in.length),
        (0x1000, 128)
    );
    assert_eq!((image.bootstrap_in.start, image.bootstrap_in.length), (0x1080, 128));
    assert_eq!(image.fixed.protocols, PROTOCOL_COE | PROTOCOL_FOE);
    assert_eq!(image.sync_managers.len(), 4);
    assert_eq!(
        (image.sync_managers[2].control, image.sync_managers[3].start),
        (0x64, 0x1180)
    );
    assert_eq!((image.pdo_bytes(2), image.pdo_bytes(3)), (2, 2));
    assert!(image.has_clock && !image.is_emulated && image.fmmus == 2);
    assert_eq!(device.image()[..8], [0x08, 0x0E, 0x03, 0x44, 0x0A, 0, 0, 0]);
    assert_eq!(device.image()[14], checksum(&device.image()[..14]));
}

#[test]
fn objects_have_their_types_rights_and_defaults() {
    let device = device();
    let [kind, name, limit, settings] = device.objects() else {
        panic!("{:?}", device.objects());
    };
    assert_eq!(kind.entries[0].content, Content::Fixed(vec![0x89, 0x13, 0x02, 0x00]));
    assert_eq!(name.entries[0].content, Content::Fixed(b"IO-1".to_vec()));
    assert_eq!(
        (limit.entries[0].kind, limit.entries[0].access),
        (DataType::Integer16, access::READ_WRITE | access::TX)
    );
    assert!(matches!(limit.entries[0].content, Content::Number { value: -5, .. }));
    assert_eq!((settings.code, settings.entries.len()), (ObjectCode::Array, 3));
    assert_eq!(settings.entries[0].content, Content::Fixed(vec![2]));
    assert!(matches!(settings.entries[2].content, Content::Number { value: -8, .. }));
    assert_eq!(settings.entries[1].access, access::READ | access::WRITE_PREOP);
}

#[test]
fn a_device_is_found_by_type_product_and_revision() {
    let revision = |wanted| {
        let device = EsiDevice::parse(FILE, wanted).expect("a device");
        Image::parse(device.image()).fixed.identity.revision
    };
    assert_eq!(revision(None), 1, "the first");
    assert_eq!(revision(Some("io-1")), 0x0002_0000, "the newest");
    assert_eq!(revision(Some("0x100:1")), 1);
    let missing = EsiDevice::parse(FILE, Some("IO-2")).expect_err("no such device");
    assert!(
        missing.to_string().contains("IO-1 (0x00000100:0x00020000)"),
        "{missing}"
    );
    assert!(matches!(EsiDevice::parse("<a>", None), Err(EsiError::Xml { .. })));
    assert_eq!(
        EsiDevice::parse("<a/>", None),
        Err(EsiError::Device { known: Vec::new() })
    );
}

#[test]
fn no_file_breaks_it() {
    let seed = 11;
    println!("seed {seed}");
    let mut random = crate::random::Random::new(seed);
    let lines: Vec<&str> = FILE.split_inclusive('>').collect();
    let mut read = 0;
    for _ in 0..2_000 {
        let mut changed: Vec<String> = lines.iter().map(|line| (*line).to_owned()).collect();
        for _ in 0..random.bits() % 4 + 1 {
            let at = (random.bits() % changed.len() as u64) as usize;
            match random.bits() % 3 {
                0 => changed[at] = changed[at].replace(['0', '1', '2'], "9999999999"),
                1 => changed[at] = changed[at].replace("#x", "-"),
                _ => drop(changed.remove(at)),
            }
        }
        let wanted = random.bits().is_multiple_of(2).then_some("IO-1");
        if let Ok(device) = EsiDevice::parse(&changed.concat(), wanted) {
            read += 1;
            Image::parse(device.image());
        }
    }
    assert!(read > 200, "{read} of 2,000 were still files");
}
