//! Where the axes are: read, and compared with their targets before z presses, after a touch, and under a load.
//! Uses: `campaign::{bench::stage, bench::interlock, bench::sound, run::control}`. Never: the plan, storage, a motion.
//!
//! Not while z presses: on a wire that the axes share, each poll would be longer, and each press slower. Until they are
//! read the limits of the forces hold.

use crate::campaign::bench::interlock::{self, TripKind};
use crate::campaign::bench::sound::{read_ready, require_no_alarm, require_on, require_zero};
use crate::campaign::bench::stage::Stage;
use crate::campaign::run::control::Control;
use crate::campaign::run::halt::Halt;
use crate::clock::Clock;
use crate::record::Pose;
use crate::rig::config::RigConfig;
use crate::rig::error::RigError;
use crate::rig::traits::{AxisStatus, Bench};

impl Stage {
    /// Reads the positions of all four axes.
    ///
    /// # Errors
    /// Halts if a device does not reply.
    pub async fn pose(&self) -> Result<Pose, Halt> {
        self.pose_and_z().await.map(|(pose, _)| pose)
    }

    /// As [`Self::pose`], with the reading of z.
    ///
    /// # Errors
    /// As `pose`.
    pub async fn pose_and_z(&self) -> Result<(Pose, AxisStatus), Halt> {
        let axes = read(&self.bench).await?;
        Ok((pose_of(&self.config, &axes), axes[2]))
    }

    /// Checks before z presses that the other axes still are over this place, and that z has not sunk: the tare took a
    /// while, and the load on a tip that touches would be in its zeros. `over`: z is not compared.
    ///
    /// # Errors
    /// Trips if one is not, or if an axis has an alarm, no zero or its motor off; halts if a device does not reply, or on
    /// a request.
    pub async fn require_over(&self, control: &mut Control, over: &Pose) -> Result<(), Halt> {
        let z = OfZ::Clear { sunk_mm: self.sunk_mm() };
        let placed = reached(&self.bench, &self.config, &self.clock, over, z);
        control.attending(placed).await?.map(drop)
    }

    /// As [`Self::require_over`], while a tip touches: checks the cells meanwhile, and not the height of z.
    ///
    /// # Errors
    /// As `require_over` and `watch_while`.
    pub async fn require_still_over(
        &mut self,
        control: &mut Control,
        over: &Pose,
    ) -> Result<(), Halt> {
        self.reached_while(control, over, OfZ::Touching).await.map(drop)
    }

    /// Reads the positions of all axes while a load is held, compares them with their targets, and checks the cells
    /// meanwhile.
    ///
    /// # Errors
    /// Trips if an axis is off its target, see [`interlock::off_target`], or has an alarm, no zero or its motor off; as
    /// `watch_while`; halts if a device does not reply.
    pub async fn require_reached(
        &mut self,
        control: &mut Control,
        target: &Pose,
    ) -> Result<Pose, Halt> {
        self.reached_while(control, target, OfZ::At { z_mm: target.z_mm }).await
    }

    async fn reached_while(
        &mut self,
        control: &mut Control,
        target: &Pose,
        z: OfZ,
    ) -> Result<Pose, Halt> {
        let (bench, config, clock) = (self.bench.clone(), self.config.clone(), self.clock.clone());
        let reads = reached(&bench, &config, &clock, target, z);
        self.watch_while(control, reads).await?
    }
}

/// Where z must be, machine mm.
#[derive(Debug, Clone, Copy)]
enum OfZ {
    /// A tip touches: z is not compared.
    Touching,
    /// At this height.
    At { z_mm: f64 },
    /// Clear of the skin, not lower than this.
    Clear { sunk_mm: f64 },
}

/// Reads the axes and checks them. If one is not as it must be, all are read again: Modbus TCP has no checksum, and a
/// flipped bit does not recur.
async fn reached(
    bench: &Bench,
    config: &RigConfig,
    clock: &Clock,
    target: &Pose,
    z: OfZ,
) -> Result<Pose, Halt> {
    let axes = read_ready(clock, || read(bench)).await?;
    let first = checked(bench, config, &axes, target, z);
    if first.is_ok() {
        return first;
    }
    checked(bench, config, &read(bench).await?, target, z)
}

fn checked(
    bench: &Bench,
    config: &RigConfig,
    axes: &[AxisStatus; 4],
    target: &Pose,
    z: OfZ,
) -> Result<Pose, Halt> {
    for (axis, status) in [&bench.x, &bench.y, &bench.z, &bench.radial].into_iter().zip(axes) {
        require_no_alarm(axis.as_ref(), status)?;
        require_zero(axis.as_ref(), status)?;
        require_on(axis.as_ref(), status)?;
    }
    let pose = pose_of(config, axes);
    let z_mm = match z {
        OfZ::At { z_mm } => z_mm,
        OfZ::Clear { sunk_mm } if pose.z_mm > sunk_mm => {
            let at = pose.z_mm;
            let detail =
                format!("z sank to {at:.3} mm before a press, limit {sunk_mm:.3} mm to be clear");
            return Err(Halt::trip(TripKind::Position, detail));
        }
        OfZ::Clear { .. } | OfZ::Touching => pose.z_mm,
    };
    let target = Pose { z_mm, ..*target };
    match interlock::off_target(config, &pose, &target) {
        Some(words) => Err(Halt::trip(TripKind::Position, words)),
        None => Ok(pose),
    }
}

/// Reads x, y, z and the radial axis.
async fn read(bench: &Bench) -> Result<[AxisStatus; 4], RigError> {
    let (x, y, z, radial) =
        futures::join!(bench.x.status(), bench.y.status(), bench.z.status(), bench.radial.status());
    Ok([x?, y?, z?, radial?])
}

fn pose_of(config: &RigConfig, [x, y, z, radial]: &[AxisStatus; 4]) -> Pose {
    let radius_mm = config.slot.radius_mm(radial.position);
    Pose { x_mm: x.position, y_mm: y.position, z_mm: z.position, radius_mm }
}
