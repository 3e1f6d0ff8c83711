//! Any bytes as a configuration, in a message and in a file.

use crate::firmware::{framed, greeting, talk};
use etherpen::config::Config;
use etherpen::link::frame::decode;
use etherpen::link::message::MESSAGE_BYTES_MAX;
use etherpen::messages::{Command, HostMessage};
use etherpen::robots::Kinematics;
use host_tools::settings::Settings;

/// Reads a configuration as the firmware does; one within its bounds is used.
pub(crate) fn wire(bytes: &[u8]) {
    if let Ok(config) = decode::<Config>(bytes) {
        used(&config);
    }
}

/// Configures the firmware, whether the configuration is within its bounds or not, and orders motion.
fn used(config: &Config) {
    let is_right = config.check().is_ok();
    let mut room = [0; MESSAGE_BYTES_MAX];
    let bytes = postcard::to_slice(config, &mut room).expect("a decoded configuration fits a message");
    let again = decode::<Config>(bytes).expect("what was encoded is decoded");
    assert_eq!(again.hash(), config.hash());
    let mut said = framed(&greeting());
    let commands = [
        Command::Home,
        Command::Enable,
        Command::Jog {
            velocity_mm_s: [9.0; 3],
        },
        Command::Draw { job: 1 },
    ];
    said.extend(framed(&HostMessage::Configure {
        id: 1,
        config: config.clone(),
    }));
    for (id, command) in (2..).zip(commands) {
        said.extend(framed(&HostMessage::Command { id, command }));
    }
    talk(&said);
    if is_right {
        assert!(config.hash().is_some(), "a configuration within its bounds has a hash");
        // Dimensions within their bounds may still form no robot; the firmware says so.
        let _ = Kinematics::new(&config.geometry);
    }
}

/// The configurations of the samples.
fn samples() -> Vec<Config> {
    let read = |text: &str| toml::from_str(text).expect("a sample is a configuration");
    let mut all: Vec<Config> = FILES.into_iter().map(read).collect();
    all.push(Config::default());
    all
}

const FILES: [&str; 3] = [
    include_str!("../../../samples/etherpen.toml"),
    include_str!("../../../samples/play.toml"),
    include_str!("../../../samples/play-udp.toml"),
];

/// The configurations of the samples, encoded.
pub(crate) fn wire_seeds() -> Vec<Vec<u8>> {
    let encode = |config: &Config| {
        let mut room = [0; MESSAGE_BYTES_MAX];
        postcard::to_slice(config, &mut room)
            .expect("a configuration fits")
            .to_vec()
    };
    samples().iter().map(encode).collect()
}

/// Reads a configuration file, changes a value, and reads what would be written.
pub(crate) fn file(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let mut settings = match Settings::parse(text) {
        Ok(settings) => settings,
        Err(error) => return assert!(!error.to_string().is_empty()),
    };
    if let Err(error) = settings.set_axis(1, "feed_forward_lead_ms", 3.25) {
        assert!(!error.to_string().is_empty());
    }
    match settings.config() {
        Ok(config) => {
            let again = toml::to_string(&config).expect("a configuration is written");
            let again: Config = toml::from_str(&again).expect("what was written is read");
            assert_eq!(again, config);
            used(&config);
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

/// The samples, and short files.
pub(crate) fn file_seeds() -> Vec<Vec<u8>> {
    let short = [
        "[motion]\nspeed_mm_s = 150.0\n",
        "axes = [{}, {}, {gear = 12.0}, {}]\n",
        "[bus]\ntransport = \"udp\"\naddress = \"192.168.1.2/24\"\n",
    ];
    FILES
        .into_iter()
        .chain(short)
        .map(|text| text.as_bytes().to_vec())
        .collect()
}
