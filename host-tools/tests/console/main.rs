//! The operator's console from the outside: over its socket, and in a browser.

mod browser;
mod client;
mod page;
mod protocol;
mod stopping;
mod studio;
mod truth;
mod updates;
