//! Between the tasks and the operating modes: translates what the tasks report.

mod bus_condition;

pub use bus_condition::bus_condition;
