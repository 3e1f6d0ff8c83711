//! The operator's console from the outside: over its socket, and in a browser.

mod axes;
mod browser;
mod client;
mod hostile;
mod jog_keys;
mod layers;
mod page;
mod photograph;
mod photograph_page;
mod preparation;
mod protocol;
mod resumed;
mod sheet;
mod stopping;
mod truth;
mod unfinished;
mod updates;
