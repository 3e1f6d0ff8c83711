//! Dimensions of all kinds of robots: one choice in the configuration and in messages.
//!
//! A configuration file names the kind and gives its dimensions side by side: `kind = "gantry"`, then the keys of that
//! kind; without a kind the dimensions are a delta robot's. A message numbers the kinds in the order of [`Kind`].

use super::corexy::CoreXyGeometry;
use super::delta::DeltaGeometry;
use super::gantry::GantryGeometry;
use super::kind::Kind;
use super::linear_delta::LinearDeltaGeometry;
use super::scara::ScaraGeometry;
use super::{MAIN_AXES, flat};
use crate::bounds::{Bound, bound};
use crate::work_volume::WorkVolume;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

impl Kind {
    /// Dimensions of a usual machine of this kind.
    #[must_use]
    pub fn geometry(self) -> Geometry {
        match self {
            Self::Delta => Geometry::Delta(DeltaGeometry::default()),
            Self::Gantry => Geometry::Gantry(GantryGeometry::default()),
            Self::CoreXy => Geometry::CoreXy(CoreXyGeometry::default()),
            Self::Scara => Geometry::Scara(ScaraGeometry::default()),
            Self::LinearDelta => Geometry::LinearDelta(LinearDeltaGeometry::default()),
        }
    }
}

/// Dimensions of a robot: its kind, with the lengths and ranges that this kind has.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(remote = "Self")]
pub enum Geometry {
    /// Of a delta robot.
    Delta(DeltaGeometry),
    /// Of a gantry.
    Gantry(GantryGeometry),
    /// Of a machine with two crossed belts.
    CoreXy(CoreXyGeometry),
    /// Of a SCARA.
    Scara(ScaraGeometry),
    /// Of a linear delta.
    LinearDelta(LinearDeltaGeometry),
}

/// The form of configuration files: the kind's name beside the dimensions.
#[derive(Serialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
enum Named<'a> {
    Delta(&'a DeltaGeometry),
    Gantry(&'a GantryGeometry),
    #[serde(rename = "corexy")]
    CoreXy(&'a CoreXyGeometry),
    Scara(&'a ScaraGeometry),
    LinearDelta(&'a LinearDeltaGeometry),
}

impl Serialize for Geometry {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if !serializer.is_human_readable() {
            return Self::serialize(self, serializer);
        }
        match self {
            Self::Delta(geometry) => Named::Delta(geometry),
            Self::Gantry(geometry) => Named::Gantry(geometry),
            Self::CoreXy(geometry) => Named::CoreXy(geometry),
            Self::Scara(geometry) => Named::Scara(geometry),
            Self::LinearDelta(geometry) => Named::LinearDelta(geometry),
        }
        .serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Geometry {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if !deserializer.is_human_readable() {
            return Self::deserialize(deserializer);
        }
        let flat::Table { kind, rest } = flat::Table::read(deserializer)?;
        Ok(match kind {
            Kind::Delta => Self::Delta(rest.into_dimensions()?),
            Kind::Gantry => Self::Gantry(rest.into_dimensions()?),
            Kind::CoreXy => Self::CoreXy(rest.into_dimensions()?),
            Kind::Scara => Self::Scara(rest.into_dimensions()?),
            Kind::LinearDelta => Self::LinearDelta(rest.into_dimensions()?),
        })
    }
}

impl From<DeltaGeometry> for Geometry {
    fn from(geometry: DeltaGeometry) -> Self {
        Self::Delta(geometry)
    }
}

impl Default for Geometry {
    /// The dimensions of [`Kind::default`].
    fn default() -> Self {
        Kind::default().geometry()
    }
}

impl Geometry {
    /// Number of rows in [`Geometry::bounds`].
    pub const BOUNDS: usize = 13;

    /// The kind of robot.
    #[must_use]
    pub fn kind(&self) -> Kind {
        match self {
            Self::Delta(_) => Kind::Delta,
            Self::Gantry(_) => Kind::Gantry,
            Self::CoreXy(_) => Kind::CoreXy,
            Self::Scara(_) => Kind::Scara,
            Self::LinearDelta(_) => Kind::LinearDelta,
        }
    }

    /// Hard bounds of the dimensions, named as configuration files write them. Rows that a kind does not need are
    /// without a name.
    #[must_use]
    pub fn bounds(&self) -> [Bound; Self::BOUNDS] {
        match self {
            Self::Delta(geometry) => padded(&geometry.bounds()),
            Self::Gantry(geometry) => padded(&geometry.bounds()),
            Self::CoreXy(geometry) => padded(&geometry.bounds()),
            Self::Scara(geometry) => padded(&geometry.bounds()),
            Self::LinearDelta(geometry) => padded(&geometry.bounds()),
        }
    }

    /// Largest horizontal distance of the tool from the frame's origin that the dimensions allow, mm.
    #[must_use]
    pub fn reach_mm(&self) -> f64 {
        match self {
            Self::Delta(geometry) => geometry.reach_mm(),
            Self::Gantry(geometry) => corner_mm(geometry.x_range_mm, geometry.y_range_mm),
            Self::CoreXy(geometry) => corner_mm(geometry.x_range_mm, geometry.y_range_mm),
            Self::Scara(geometry) => geometry.reach_mm(),
            Self::LinearDelta(geometry) => geometry.reach_mm(),
        }
    }

    /// Lowest and highest z of the tool that the dimensions allow, mm.
    #[must_use]
    pub fn heights_mm(&self) -> [f64; 2] {
        match self {
            Self::Delta(geometry) => [-geometry.reach_mm(), 0.0],
            Self::Gantry(geometry) => geometry.z_range_mm,
            Self::CoreXy(geometry) => geometry.z_range_mm,
            Self::Scara(geometry) => geometry.z_range_mm,
            Self::LinearDelta(geometry) => geometry.heights_mm(),
        }
    }

    /// Whether curves need a finer grid, because a joint moves the tool in one direction alone: its limits bind where a
    /// curve turns into that direction, and not before.
    pub(crate) fn needs_fine_curves(&self) -> bool {
        match self {
            Self::Delta(_) => false,
            Self::Gantry(_) | Self::CoreXy(_) | Self::Scara(_) | Self::LinearDelta(_) => true,
        }
    }

    /// Lowest and highest angle of each main axis, rad.
    #[must_use]
    pub fn ranges_rad(&self) -> [[f64; 2]; MAIN_AXES] {
        match self {
            Self::Delta(geometry) => geometry.ranges_rad(),
            Self::Gantry(geometry) => geometry.ranges_rad(),
            Self::CoreXy(geometry) => geometry.ranges_rad(),
            Self::Scara(geometry) => geometry.ranges_rad(),
            Self::LinearDelta(geometry) => geometry.ranges_rad(),
        }
    }

    /// Lowest and highest position of each of [`Kind::slides`], rad.
    #[must_use]
    pub fn slide_ranges_rad(&self) -> [[f64; 2]; MAIN_AXES] {
        match self {
            Self::CoreXy(geometry) => geometry.slide_ranges_rad(),
            Self::Delta(_) | Self::Gantry(_) | Self::Scara(_) | Self::LinearDelta(_) => self.ranges_rad(),
        }
    }

    /// Lowest and highest angle of each main axis, rad, with the configured margin taken off both ends.
    #[must_use]
    pub fn ranges_with_margin_rad(&self) -> [[f64; 2]; MAIN_AXES] {
        let margins = match self {
            Self::Delta(geometry) => geometry.margins_rad(),
            Self::Gantry(geometry) => geometry.margins_rad(),
            Self::CoreXy(geometry) => geometry.margins_rad(),
            Self::Scara(geometry) => geometry.margins_rad(),
            Self::LinearDelta(geometry) => geometry.margins_rad(),
        };
        let mut ranges_rad = self.ranges_rad();
        for ([low, high], margin) in ranges_rad.iter_mut().zip(margins) {
            (*low, *high) = (*low + margin, *high - margin);
        }
        ranges_rad
    }

    /// Lowest and highest angle of the fourth axis, rad.
    #[must_use]
    pub fn turn_range_rad(&self) -> [f64; 2] {
        match self {
            Self::Delta(geometry) => geometry.turn_range_rad,
            Self::Gantry(geometry) => geometry.turn_range_rad,
            Self::CoreXy(geometry) => geometry.turn_range_rad,
            Self::Scara(geometry) => geometry.turn_range_rad,
            Self::LinearDelta(geometry) => geometry.turn_range_rad,
        }
    }

    /// The largest usual work volume of a machine of these dimensions.
    #[must_use]
    pub fn work_volume(&self) -> WorkVolume {
        match self {
            Self::Delta(_) => WorkVolume::default(),
            Self::Gantry(geometry) => geometry.work_volume(),
            Self::CoreXy(geometry) => geometry.work_volume(),
            Self::Scara(geometry) => geometry.work_volume(),
            Self::LinearDelta(geometry) => geometry.work_volume(),
        }
    }

    /// Usual highest speed and acceleration of each main axis of such a machine, rad/s and rad/s2.
    #[must_use]
    pub fn usual_limits(&self) -> [[f64; 2]; MAIN_AXES] {
        match self {
            Self::Delta(_) => DeltaGeometry::usual_limits(),
            Self::Gantry(geometry) => geometry.usual_limits(),
            Self::CoreXy(geometry) => geometry.usual_limits(),
            Self::Scara(geometry) => geometry.usual_limits(),
            Self::LinearDelta(geometry) => geometry.usual_limits(),
        }
    }

    /// Borders of the tool's position that the ranges of the joints do not express, with the margin taken off.
    pub(crate) fn box_mm(&self) -> Option<WorkVolume> {
        match self {
            Self::CoreXy(geometry) => Some(geometry.work_volume()),
            Self::Delta(_) | Self::Gantry(_) | Self::Scara(_) | Self::LinearDelta(_) => None,
        }
    }

    /// These dimensions with ranges of the joints that end nowhere, for questions about the kinematics alone.
    #[must_use]
    pub fn without_ranges(self) -> Self {
        match self {
            Self::Delta(geometry) => Self::Delta(geometry.without_ranges()),
            Self::Gantry(geometry) => Self::Gantry(geometry.without_ranges()),
            Self::CoreXy(geometry) => Self::CoreXy(geometry.without_ranges()),
            Self::Scara(geometry) => Self::Scara(geometry.without_ranges()),
            Self::LinearDelta(geometry) => Self::LinearDelta(geometry.without_ranges()),
        }
    }
}

/// The table of all kinds from a kind's rows.
fn padded(rows: &[Bound]) -> [Bound; Geometry::BOUNDS] {
    let mut all = [bound("", 0.0, 0.0, 0.0); Geometry::BOUNDS];
    all.iter_mut().zip(rows).for_each(|(place, row)| *place = *row);
    all
}

/// Distance of the farthest corner of a rectangle from the origin, mm.
fn corner_mm(x_mm: [f64; 2], y_mm: [f64; 2]) -> f64 {
    let farthest = |[low, high]: [f64; 2]| low.abs().max(high.abs());
    libm::hypot(farthest(x_mm), farthest(y_mm))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kinds_usual_machine_is_within_its_bounds() {
        for kind in Kind::ALL {
            let geometry = kind.geometry();
            assert_eq!(geometry.kind(), kind);
            assert_eq!(Kind::named(kind.name()), Some(kind));
            assert_eq!(crate::bounds::first_violation(&geometry.bounds()), Ok(()), "{kind:?}");
            assert!(super::super::Kinematics::new(&geometry).is_ok(), "{kind:?}");
        }
        assert_eq!(Kind::named("hexapod"), None);
    }
}
