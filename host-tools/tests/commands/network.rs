//! Two network namespaces with a cable between them; needs root; removed when dropped.
//!
//! Without permission, tests that need one print that and are skipped; for root that is a failure.

use std::fs::{self, File};
use std::io::Write;
use std::os::fd::AsFd;
use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread::Scope;

/// Prefix of the namespaces' names; the process number and a running number follow.
const PREFIX: &str = "etherpen-test-";

/// Set to anything, tests fail where they would be left out: continuous integration has root.
const REQUIRE: &str = "ETHERPEN_REQUIRE_NETWORK";

/// Two namespaces and a pair of interfaces.
pub(crate) struct Network {
    namespaces: [String; 2],
    interfaces: [String; 2],
}

fn ip(words: &str) -> Result<String, String> {
    let output = Command::new("ip").args(words.split_whitespace()).output();
    let output = output.map_err(|cause| format!("ip cannot be started: {cause}"))?;
    if output.status.success() {
        Ok(String::from_utf8_lossy(&output.stdout).into_owned())
    } else {
        Err(format!("ip {words}: {}", String::from_utf8_lossy(&output.stderr)))
    }
}

/// Removes what killed tests have left behind.
fn tidy() {
    let listed = ip("netns list").unwrap_or_default();
    for name in listed.lines().filter_map(|line| line.split_whitespace().next()) {
        let owner = name.strip_prefix(PREFIX).and_then(|rest| rest.split('-').next());
        if owner.is_some_and(|owner| !fs::exists(format!("/proc/{owner}")).unwrap_or(true)) {
            // Another test may have been faster.
            let _ = ip(&format!("netns delete {name}"));
        }
    }
}

impl Network {
    /// A network; `None`, with a message, if this user cannot create one.
    pub(crate) fn new(test: &str) -> Option<Self> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        static SETUP: Mutex<()> = Mutex::new(());
        if !rustix::process::geteuid().is_root() {
            let message = format!("SKIPPED {test}: it makes network namespaces, which takes root");
            // Bypasses the test harness, which hides the output of tests that pass.
            let _ = writeln!(std::io::stderr(), "{message}");
            let required = std::env::var_os(REQUIRE).is_some_and(|value| !value.is_empty());
            assert!(!required, "{REQUIRE} is set, but: {message}");
            return None;
        }
        let guard = SETUP.lock();
        host_tools::setup::ensure_program("ip").expect("iproute2");
        tidy();
        drop(guard);
        let id = format!("{}-{}", std::process::id(), NUMBER.fetch_add(1, Ordering::Relaxed));
        let network = Self {
            namespaces: ["a", "b"].map(|end| format!("{PREFIX}{id}-{end}")),
            interfaces: ["a", "b"].map(|end| format!("ep{}{end}", id.replace('-', "x"))),
        };
        let [a, b] = &network.namespaces;
        let [at_a, at_b] = &network.interfaces;
        for name in &network.namespaces {
            ip(&format!("netns add {name}")).expect("root may make a namespace");
        }
        ip(&format!(
            "link add {at_a} netns {a} type veth peer name {at_b} netns {b}"
        ))
        .expect("root may make a cable");
        for (name, interface) in network.namespaces.iter().zip(&network.interfaces) {
            ip(&format!("-n {name} link set {interface} promisc on up")).expect("root may switch it on");
        }
        std::thread::scope(|scope| {
            for end in 0..network.namespaces.len() {
                // A kernel without IPv6 has nothing to disable.
                network.spawn(scope, end, || {
                    fs::write("/proc/sys/net/ipv6/conf/all/disable_ipv6", "1").ok()
                });
            }
        });
        Some(network)
    }

    /// The two interfaces.
    pub(crate) fn interfaces(&self) -> [&str; 2] {
        [&self.interfaces[0], &self.interfaces[1]]
    }

    /// A program in one of the namespaces.
    pub(crate) fn command(&self, end: usize, program: &Command) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.namespaces[end]]);
        command.arg(program.get_program()).args(program.get_args());
        command
    }

    /// A thread in one of the namespaces.
    pub(crate) fn spawn<'scope, T: Send + 'scope>(
        &self,
        scope: &'scope Scope<'scope, '_>,
        end: usize,
        work: impl FnOnce() -> T + Send + 'scope,
    ) -> std::thread::ScopedJoinHandle<'scope, T> {
        let namespace = File::open(format!("/var/run/netns/{}", self.namespaces[end])).expect("ip has put it there");
        scope.spawn(move || {
            let kind = Some(rustix::thread::LinkNameSpaceType::Network);
            rustix::thread::move_into_link_name_space(namespace.as_fd(), kind).expect("root may move");
            work()
        })
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        for name in &self.namespaces {
            // The cable is removed with its ends; the next test removes the rest.
            let _ = ip(&format!("netns delete {name}"));
        }
    }
}
