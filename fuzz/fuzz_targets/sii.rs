//! Any bytes as a slave's configuration memory, over the slice and word by word.
#![no_main]

use etherpen::ethercat::wire::sii::{CategoryWalker, Sii};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|image: &[u8]| {
    let word = |address: u16| {
        let at = usize::from(address) * 2;
        image
            .get(at..at + 2)
            .map_or(0, |word| u16::from_le_bytes([word[0], word[1]]))
    };
    let mut walker = CategoryWalker::new(u16::try_from(image.len() / 2).unwrap_or(u16::MAX));
    let mut found = vec![];
    while let Some(address) = walker.next_word() {
        found.extend(walker.feed(word(address), word(address.saturating_add(1))));
    }
    let Ok(sii) = Sii::new_checked(image) else { return };
    let mut categories = sii.categories();
    let same: Vec<_> = categories.by_ref().map(|(category, _)| category).collect();
    assert_eq!((same, categories.walker().end()), (found, walker.end()));
    let _ = (sii.header(), sii.checksum_is_right(), sii.general());
    for index in 0..=255 {
        assert!(sii.strings().text(index).len() <= 255);
    }
    for pdo in sii.tx_pdos().chain(sii.rx_pdos()).flatten() {
        assert!(pdo.bits() as usize <= 255 * pdo.entries().count());
        assert_eq!(pdo.entries().count(), usize::from(pdo.record.entries));
    }
    let records = sii.sync_managers().count() + sii.fmmus().count() + sii.fmmus_extended().count();
    assert!(records + sii.sync_units().count() + sii.clocks().count() <= 5 * image.len());
});
