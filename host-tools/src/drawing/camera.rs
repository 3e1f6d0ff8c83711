//! One photograph from a camera.
//!
//! A camera is a V4L2 device, or a recording of one: a file or pipe of consecutive JPEG pictures (Motion JPEG). The
//! first pictures of a camera are too dark or too bright, so a later one is used.
//!
//! Invariant: a camera that delivers no complete picture causes an error, not an endless wait.

use super::photo::decode;
use image::{ImageFormat, RgbImage};
use linuxvideo::format::{PixFormat, PixelFormat};
use linuxvideo::{BufType, Device};
use std::fmt;
use std::io::{self, Read};
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::Duration;

/// Number of pictures until the camera's exposure has settled; the last one is used.
const PICTURES: usize = 12;
/// Longest wait for the pictures.
const PATIENCE: Duration = Duration::from_secs(15);
/// Requested size, pixels; the camera selects the nearest one.
const SIZE: [u32; 2] = [1280, 960];
/// Most bytes read of a recorded stream.
const STREAM_BYTES_MAX: u64 = 64 << 20;
/// Beginning and end of a JPEG picture.
const JPEG_BEGIN: [u8; 3] = [0xFF, 0xD8, 0xFF];
const JPEG_END: [u8; 2] = [0xFF, 0xD9];

/// Why a camera gave no photograph.
#[derive(Debug)]
pub enum CameraError {
    /// The device does not exist; these devices do.
    Missing(Vec<PathBuf>),
    /// The user may not open the device.
    Denied,
    /// The device cannot capture pictures.
    NoCamera,
    /// The pictures have an unknown format.
    Format(String),
    /// No complete picture arrived in time.
    NoPicture,
    /// Any other error of the operating system.
    System(io::Error),
}

impl fmt::Display for CameraError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Missing(found) if found.is_empty() => {
                write!(
                    f,
                    "there is no such camera, and no other (/dev/video*): plug one in, or draw a file"
                )
            }
            Self::Missing(found) => {
                let found: Vec<String> = found.iter().map(|path| path.display().to_string()).collect();
                write!(f, "there is no such camera; there is {}", found.join(", "))
            }
            Self::Denied => write!(
                f,
                "no right to open the camera: add the user to the group `video`, then log in again"
            ),
            Self::NoCamera => write!(
                f,
                "this is no camera (no V4L2 video capture) and no recorded stream of JPEG pictures"
            ),
            Self::Format(name) => write!(f, "the camera's pictures are {name}; MJPG, JPEG and YUYV are known"),
            Self::NoPicture => write!(
                f,
                "no whole picture came from the camera within {} s",
                PATIENCE.as_secs()
            ),
            Self::System(cause) => write!(f, "the camera cannot be used: {cause}"),
        }
    }
}

impl std::error::Error for CameraError {}

impl From<io::Error> for CameraError {
    fn from(cause: io::Error) -> Self {
        match cause.kind() {
            io::ErrorKind::NotFound => Self::Missing(cameras()),
            io::ErrorKind::PermissionDenied => Self::Denied,
            _ => Self::System(cause),
        }
    }
}

/// The video devices of this machine, by name.
fn cameras() -> Vec<PathBuf> {
    let entries = std::fs::read_dir("/dev").into_iter().flatten().flatten();
    let is_video = |path: &PathBuf| path.to_string_lossy().starts_with("/dev/video");
    let mut found: Vec<PathBuf> = entries.map(|entry| entry.path()).filter(is_video).collect();
    found.sort();
    found
}

/// Takes a photograph.
///
/// # Errors
/// [`CameraError`].
pub fn take_photograph(device: impl AsRef<Path>) -> Result<RgbImage, CameraError> {
    let device = device.as_ref().to_owned();
    let is_device = std::fs::metadata(&device)?.file_type().is_char_device();
    let (sender, taken) = mpsc::channel();
    let work = move || {
        let picture = if is_device {
            from_device(&device)
        } else {
            from_stream(&device)
        };
        // The receiver is gone if this took too long.
        let _ = sender.send(picture);
    };
    std::thread::Builder::new().name("camera".into()).spawn(work)?;
    taken.recv_timeout(PATIENCE).map_err(|_| CameraError::NoPicture)?
}

fn from_device(path: &Path) -> Result<RgbImage, CameraError> {
    let device = Device::open(path).map_err(|cause| match cause.raw_os_error() {
        // ENOTTY and EINVAL: the device does not support V4L2 requests.
        Some(25 | 22) => CameraError::NoCamera,
        _ => CameraError::from(cause),
    })?;
    if !device
        .supported_buf_types()
        .contains(linuxvideo::BufTypes::VIDEO_CAPTURE)
    {
        return Err(CameraError::NoCamera);
    }
    let offered = device
        .formats(BufType::VIDEO_CAPTURE)
        .flatten()
        .map(|format| format.pixel_format());
    let offered: Vec<PixelFormat> = offered.collect();
    let known = [PixelFormat::MJPG, PixelFormat::JPEG, PixelFormat::YUYV];
    let Some(format) = known.into_iter().find(|format| offered.contains(format)) else {
        let names: Vec<String> = offered.iter().map(ToString::to_string).collect();
        return Err(CameraError::Format(names.join(", ")));
    };
    let capture = device.video_capture(PixFormat::new(SIZE[0], SIZE[1], format))?;
    let (width, height, line) = (
        capture.format().width(),
        capture.format().height(),
        capture.format().bytes_per_line(),
    );
    let mut stream = capture.into_stream()?;
    let mut last = None;
    for _ in 0..PICTURES {
        let picture = stream.dequeue(|view| {
            Ok(match format {
                PixelFormat::YUYV => from_yuyv(&view, width, height, line),
                _ => decode(&view, ImageFormat::Jpeg).ok(),
            })
        })?;
        last = picture.or(last);
    }
    last.ok_or(CameraError::NoPicture)
}

/// YUYV: two pixels in four bytes, with one brightness each and two common colour differences (ITU-R BT.601, 16 to
/// 235).
fn from_yuyv(bytes: &[u8], width: u32, height: u32, line: u32) -> Option<RgbImage> {
    let line = (line as usize).max(width as usize * 2);
    let pixel = |x: u32, y: u32| {
        let pair = y as usize * line + (x as usize / 2) * 4;
        let at = |offset: usize| bytes.get(pair + offset).map(|byte| f32::from(*byte));
        let brightness = 1.164 * (at(if x.is_multiple_of(2) { 0 } else { 2 })? - 16.0);
        let (blue, red) = (at(1)? - 128.0, at(3)? - 128.0);
        Some(
            [
                brightness + 1.596 * red,
                brightness - 0.392 * blue - 0.813 * red,
                brightness + 2.017 * blue,
            ]
            .map(|value| value.clamp(0.0, 255.0) as u8),
        )
    };
    let mut picture = RgbImage::new(width, height);
    for (x, y, to) in picture.enumerate_pixels_mut() {
        to.0 = pixel(x, y)?;
    }
    Some(picture)
}

fn from_stream(path: &Path) -> Result<RgbImage, CameraError> {
    let mut file = std::fs::File::open(path)?.take(STREAM_BYTES_MAX);
    let (mut bytes, mut last, mut seen) = (Vec::new(), None, 0);
    let mut chunk = vec![0; 1 << 16];
    while seen < PICTURES {
        let count = file.read(&mut chunk)?;
        bytes.extend_from_slice(chunk.get(..count).unwrap_or_default());
        while seen < PICTURES
            && let Some((picture, rest)) = next_picture(&bytes)
        {
            seen += 1;
            last = decode(picture, ImageFormat::Jpeg).ok().or(last);
            bytes = rest.to_vec();
        }
        if count == 0 {
            break;
        }
    }
    match last {
        Some(picture) => Ok(picture),
        None if seen == 0 => Err(CameraError::NoCamera),
        None => Err(CameraError::NoPicture),
    }
}

/// The first picture of a stream, and the bytes after it.
fn next_picture(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let begin = find(bytes, &JPEG_BEGIN, 0)?;
    let end = find(bytes, &JPEG_END, begin)? + JPEG_END.len();
    Some((bytes.get(begin..end)?, bytes.get(end..)?))
}

fn find(bytes: &[u8], wanted: &[u8], from: usize) -> Option<usize> {
    let windows = bytes.get(from..)?.windows(wanted.len());
    windows
        .into_iter()
        .position(|window| window == wanted)
        .map(|at| from + at)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::codecs::jpeg::JpegEncoder;

    /// A picture of uniform grey, as a camera sends it.
    fn jpeg(grey: u8) -> Vec<u8> {
        let mut bytes = Vec::new();
        let picture = RgbImage::from_pixel(64, 48, image::Rgb([grey; 3]));
        JpegEncoder::new(&mut bytes).encode_image(&picture).expect("a picture");
        bytes
    }

    fn recorded(name: &str, bytes: &[u8]) -> Result<u8, CameraError> {
        let path = std::env::temp_dir().join(format!("etherpen-camera-{name}-{}", std::process::id()));
        std::fs::write(&path, bytes).expect("a file");
        let taken = take_photograph(&path);
        std::fs::remove_file(&path).expect("the file");
        taken.map(|picture| picture.get_pixel(20, 20).0[0])
    }

    #[test]
    fn the_picture_after_the_exposure_has_settled_is_taken() {
        let stream: Vec<u8> = (0..30).flat_map(|number| jpeg(number * 8)).collect();
        let grey = recorded("settled", &stream).expect("a picture");
        assert!(grey.abs_diff(11 * 8) <= 2, "{grey}");
        // A short recording whose beginning and end are cut off.
        let mut short = jpeg(10);
        short.drain(..100);
        short.extend(jpeg(120));
        short.extend(&jpeg(200)[..200]);
        let grey = recorded("short", &short).expect("a picture");
        assert!(grey.abs_diff(120) <= 2, "{grey}");
    }

    #[test]
    fn what_is_no_camera_is_told_with_a_remedy() {
        let text = |device: &str| take_photograph(device).map(|_| ()).expect_err("no camera").to_string();
        assert!(text("/dev/no-such-camera").contains("no such camera"));
        assert!(text("/dev/null").contains("no camera"), "{}", text("/dev/null"));
        assert!(matches!(recorded("text", b"no pictures"), Err(CameraError::NoCamera)));
        let mut damaged = jpeg(50);
        damaged.drain(20..400);
        assert!(matches!(recorded("damaged", &damaged), Err(CameraError::NoPicture)));
    }

    #[test]
    fn brightness_and_colour_differences_become_red_green_and_blue() {
        // Black, white; red in BT.601.
        let bytes = [16, 128, 235, 128, 81, 90, 81, 240];
        let picture = from_yuyv(&bytes, 2, 2, 4).expect("a picture");
        let near = |x, y, wanted: [u8; 3]| {
            picture
                .get_pixel(x, y)
                .0
                .iter()
                .zip(wanted)
                .all(|(a, b)| a.abs_diff(b) <= 3)
        };
        assert!(
            near(0, 0, [0; 3]) && near(1, 0, [255; 3]) && near(0, 1, [255, 0, 0]),
            "{picture:?}"
        );
        assert!(from_yuyv(&bytes[..7], 2, 2, 4).is_none(), "cut off");
    }
}
