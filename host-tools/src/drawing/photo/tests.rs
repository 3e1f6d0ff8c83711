use super::*;
use crate::drawing::{Input, load};
use image::{GrayImage, ImageBuffer, Luma, Rgba, RgbaImage};

fn sample() -> Vec<u8> {
    std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../samples/astronaut.png")).unwrap_or_default()
}

fn load_bytes(name: &str, bytes: &[u8]) -> Result<Input, DrawingError> {
    let folder = std::env::temp_dir().join(format!("etherpen-drawing-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    let path = folder.join(name);
    std::fs::write(&path, bytes)?;
    let result = load(&path);
    std::fs::remove_file(&path)?;
    result
}

fn encoded(picture: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, format).expect("encoding into memory");
    bytes.into_inner()
}

#[test]
fn files_that_are_no_pictures_are_named_as_such() {
    assert_eq!(load("/no/such/file.png").err(), Some(DrawingError::Missing));
    assert!(matches!(load(std::env::temp_dir()), Err(DrawingError::Unreadable(_))));
    assert_eq!(load_bytes("empty.png", b"").err(), Some(DrawingError::Empty));
    assert_eq!(
        load_bytes("text.png", b"not a picture\n").err(),
        Some(DrawingError::UnknownContent)
    );
    assert_eq!(
        load_bytes("noise.bin", &[0xFE; 300]).err(),
        Some(DrawingError::UnknownContent)
    );
    assert_eq!(load_bytes("text.csv", b"hello\n").err(), Some(DrawingError::CsvHeading));
    assert_eq!(
        load_bytes("small.gif", b"GIF89a\x01\x00\x01\x00").err(),
        Some(DrawingError::Unsupported)
    );
}

#[test]
fn a_picture_cut_off_anywhere_is_refused() {
    let png = sample();
    assert!(load_bytes("whole.png", &png).is_ok());
    for length in [9, 40, 1000, png.len() / 2, png.len() - 100] {
        let result = load_bytes("cut.png", &png[..length]);
        assert_eq!(result.err(), Some(DrawingError::Damaged), "after {length} bytes");
    }
    let picture = DynamicImage::ImageRgb8(RgbImage::from_fn(200, 200, |x, y| image::Rgb([x as u8, y as u8, 9])));
    let jpeg = encoded(&picture, ImageFormat::Jpeg);
    assert!(load_bytes("whole.jpg", &jpeg).is_ok());
    for length in [12, 300, jpeg.len() / 2, jpeg.len() - 2] {
        let result = load_bytes("cut.jpg", &jpeg[..length]);
        assert_eq!(result.err(), Some(DrawingError::Damaged), "after {length} bytes");
    }
}

#[test]
fn damaged_bytes_never_panic() {
    let png = sample();
    for seed in 0..40_usize {
        let mut damaged = png.clone();
        for k in 0..20 {
            let at = (seed * 7919 + k * 104_729) % damaged.len().min(6000);
            damaged[at] ^= (seed + k + 1) as u8;
        }
        if let Ok(input) = load_bytes("damaged.png", &damaged) {
            assert!(matches!(input, Input::Photograph(_)), "seed {seed}");
        }
    }
}

#[test]
fn depth_and_transparency_do_not_change_the_picture() {
    let grey = GrayImage::from_fn(64, 64, |x, _| Luma([(x * 4) as u8]));
    let deep: ImageBuffer<Luma<u16>, _> = ImageBuffer::from_fn(64, 64, |x, _| Luma([(x * 4 * 257) as u16]));
    let clear = RgbaImage::from_fn(64, 64, |x, _| Rgba([0, 0, 0, 255 - (x * 4) as u8]));
    let pictures = [
        DynamicImage::ImageLuma8(grey),
        DynamicImage::ImageLuma16(deep),
        DynamicImage::ImageRgba8(clear),
    ];
    for picture in pictures {
        let Ok(Input::Photograph(loaded)) = load_bytes("kind.png", &encoded(&picture, ImageFormat::Png)) else {
            panic!("{:?} was refused", picture.color());
        };
        for x in [0_u32, 10, 63] {
            assert!(
                loaded
                    .get_pixel(x, 5)
                    .0
                    .iter()
                    .all(|value| value.abs_diff((x * 4) as u8) <= 1)
            );
        }
    }
}

#[test]
fn webp_is_read_and_a_cut_one_is_refused() {
    let picture = RgbImage::from_fn(90, 60, |x, y| image::Rgb([(x * 2) as u8, (y * 4) as u8, 30]));
    let webp = encoded(&DynamicImage::ImageRgb8(picture.clone()), ImageFormat::WebP);
    let Ok(Input::Photograph(loaded)) = load_bytes("small.webp", &webp) else {
        panic!("a WebP picture was refused");
    };
    assert_eq!(loaded, picture);
    let cut = load_bytes("cut.webp", &webp[..webp.len() / 2]);
    assert_eq!(cut.err(), Some(DrawingError::Damaged));
}

#[test]
fn a_telephones_heic_names_the_program_that_converts_it() {
    let heic = b"\0\0\0\x24ftypheic\0\0\0\0mif1heic";
    let error = load_bytes("photo.heic", heic).err();
    assert_eq!(error, Some(DrawingError::Heic));
    assert!(error.is_some_and(|error| error.to_string().contains("heif-convert")));
}

#[test]
fn inks_become_light() {
    let Ok(Input::Photograph(loaded)) =
        load_bytes("inks.jpg", include_bytes!("../../../../tests/data/pictures/cmyk.jpg"))
    else {
        panic!("a CMYK picture was refused");
    };
    for (at, expected) in [([4, 4], [0; 3]), ([24, 4], [255, 0, 0]), ([24, 28], [255; 3])] {
        let found = loaded.get_pixel(at[0], at[1]).0;
        let is_near = found.iter().zip(expected).all(|(a, b): (&u8, u8)| a.abs_diff(b) <= 30);
        assert!(is_near, "{found:?} at {at:?}");
    }
}

#[test]
fn a_camera_held_sideways_gives_an_upright_picture() {
    let picture = GrayImage::from_fn(40, 20, |x, _| Luma([if x < 20 { 20 } else { 230 }]));
    let jpeg = encoded(&DynamicImage::ImageLuma8(picture), ImageFormat::Jpeg);
    // Exif 2.3: a TIFF header and one directory with the tag Orientation, 6: turned a quarter clockwise.
    let mut exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0".to_vec();
    let mut turned = jpeg[..2].to_vec();
    turned.extend([0xFF, 0xE1, 0, exif.len() as u8 + 2]);
    turned.append(&mut exif);
    turned.extend(&jpeg[2..]);
    let Ok(Input::Photograph(loaded)) = load_bytes("turned.jpg", &turned) else {
        panic!("the picture was refused");
    };
    assert_eq!(loaded.dimensions(), (20, 40));
    assert!(loaded.get_pixel(10, 5).0[0] < 60 && loaded.get_pixel(10, 35).0[0] > 190);
}

#[test]
fn sizes_out_of_range_are_refused_before_decoding() {
    let dot = encoded(&DynamicImage::new_luma8(1, 1), ImageFormat::Png);
    let expected = DrawingError::TooSmall {
        width: 1,
        height: 1,
        side_min: SIDE_MIN,
    };
    assert_eq!(load_bytes("dot.png", &dot).err(), Some(expected));
    let mut huge = encoded(&DynamicImage::new_luma8(20, 20), ImageFormat::Png);
    huge[16..24].copy_from_slice(&[0, 0, 0xC3, 0x50, 0, 0, 0xC3, 0x50]);
    let checksum = crc32(&huge[12..29]);
    huge[29..33].copy_from_slice(&checksum.to_be_bytes());
    let expected = DrawingError::TooLarge {
        width: 50_000,
        height: 50_000,
        pixels_max: PIXELS_MAX,
    };
    assert_eq!(load_bytes("huge.png", &huge).err(), Some(expected));
}

/// Checksum of a PNG chunk.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| {
            (crc >> 1) ^ (0xEDB8_8320 & (crc & 1).wrapping_neg())
        })
    })
}
