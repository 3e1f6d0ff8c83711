//! Tests of the certifier: its arithmetic against exact integers, its kinematics against the planner's, and its
//! certificates of planned paths.

mod cross;
mod intervals;
mod paths;
mod planned;
mod planning;
