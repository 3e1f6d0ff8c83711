//! The operator's console from the outside: over its socket, and in a browser.

mod browser;
mod client;
mod hostile;
mod page;
mod protocol;
mod resumed;
mod stopping;
mod studio;
mod truth;
mod unfinished;
mod updates;
