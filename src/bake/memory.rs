//! Whether a bake or a picture fits into memory, asked before any work.
//!
//! What a process can have is bounded by the machine (memory and swap), by its control group, and by its own limit of
//! address space; the least of them counts, less what the process holds already. A bake whose estimate lies above that
//! is refused. What other programs hold at the moment may be given back before the bake needs it, so of that there is
//! a warning only, when the estimate takes more than [`TIGHT`] of what they leave. Where the system does not tell,
//! nothing is refused.
//!
//! There is no switch against the refusal: more swap, or a higher limit, lets a bake run all the same.

use luxel_export::report::Warning;
use sysinfo::{ProcessRefreshKind, ProcessesToUpdate, System};

use crate::Error;
use crate::plan::Memory;

/// Share of what is free from which on a bake is told to be tight.
const TIGHT: f64 = 0.8;

/// Memory that a process can have in addition to what it has [bytes].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Room {
    /// When all others give theirs back.
    most: u64,
    /// As things are now.
    now: u64,
}

impl Room {
    fn min(self, other: Self) -> Self {
        Self { most: self.most.min(other.most), now: self.now.min(other.now) }
    }
}

/// Compares an estimate with the memory that there is.
///
/// # Errors
/// [`Error::Memory`] where it cannot fit.
pub fn check(estimate: &Memory) -> Result<Option<Warning>, Error> {
    Budget::now().check(estimate)
}

/// The memory that there was at some time: of several bakes in one process, none is judged by what the others hold.
#[derive(Clone, Copy, Debug)]
pub struct Budget(Option<Room>);

impl Budget {
    /// As things are.
    pub fn now() -> Self {
        Self(room())
    }

    /// Compares an estimate with it.
    ///
    /// # Errors
    /// [`Error::Memory`] where it cannot fit.
    pub fn check(&self, estimate: &Memory) -> Result<Option<Warning>, Error> {
        self.0.map_or(Ok(None), |room| judge(estimate, room))
    }

    /// What can be taken without getting tight [bytes]; none where nobody tells.
    pub fn at_ease(&self) -> Option<u64> {
        self.0.map(|room| (TIGHT * room.now.min(room.most) as f64) as u64)
    }
}

fn judge(estimate: &Memory, room: Room) -> Result<Option<Warning>, Error> {
    let needed = estimate.total();
    let (part, bytes, remedy) = largest(estimate);
    let (needs, part_needs) = (mib(needed), mib(bytes));
    if needed > room.most {
        return Err(Error::Memory { needed: needs, most: mib(room.most), part, part_needs, remedy });
    }
    if needed as f64 <= TIGHT * room.now as f64 {
        return Ok(None);
    }
    let message = format!(
        "this may take {needs} MiB of memory and {} MiB are free; the largest part are {part} ({part_needs} MiB): \
         {remedy} if it fails",
        mib(room.now)
    );
    Ok(Some(Warning { code: "memory".into(), message }))
}

fn mib(bytes: u64) -> u64 {
    bytes.div_ceil(1 << 20)
}

/// The largest part of an estimate, in words, with what makes it smaller.
fn largest(estimate: &Memory) -> (&'static str, u64, &'static str) {
    const ATLAS: &str = "lower --size or --texel-density";
    let parts = [
        ("the trees of rays", estimate.rays, "bake the scene in several parts"),
        ("the surfels", estimate.surfels, "lower --voxels"),
        ("the texels", estimate.texels, ATLAS),
        ("the images", estimate.images, ATLAS),
        ("the scene's own buffers and images", estimate.files, "bake the scene in several parts"),
        ("the photons", estimate.photons, "lower --map-photons"),
        ("the pictures", estimate.picture, "lower --width or --height"),
    ];
    // The first of equal ones.
    parts.into_iter().rev().max_by_key(|(_, bytes, _)| *bytes).unwrap_or_default()
}

/// The memory that there is; none where nobody tells.
fn room() -> Option<Room> {
    let mut system = System::new().ok()?;
    system.refresh_memory();
    let pid = sysinfo::get_current_pid().ok()?;
    let only = ProcessRefreshKind::nothing().with_memory();
    system.refresh_processes_specifics(ProcessesToUpdate::Some(&[pid]), false, only);
    let own = system.process(pid)?;
    let held = own.memory();
    let machine = Room {
        most: (system.total_memory().saturating_add(system.total_swap())).saturating_sub(held),
        now: system.available_memory().saturating_add(system.free_swap()),
    };
    let mut room = (system.total_memory() > 0).then_some(machine)?;
    if let Some(group) = own.cgroup_limits() {
        let most = group.total_memory.saturating_add(group.free_swap).saturating_sub(held);
        room = room.min(Room { most, now: group.free_memory.saturating_add(group.free_swap) });
    }
    if let Some(limit) = address_space() {
        let left = limit.saturating_sub(own.virtual_memory());
        room = room.min(Room { most: left, now: left });
    }
    Some(room)
}

/// The limit of this process's address space, if it has one [bytes].
#[cfg(unix)]
fn address_space() -> Option<u64> {
    rustix::process::getrlimit(rustix::process::Resource::As).current
}

#[cfg(not(unix))]
fn address_space() -> Option<u64> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    const GIB: u64 = 1 << 30;

    #[test]
    fn what_cannot_fit_is_refused_with_its_largest_part_and_the_remedy() {
        let estimate = Memory { rays: GIB, surfels: 3 * GIB, texels: 2 * GIB, ..Memory::default() };
        let judged = |most: u64, now: u64| judge(&estimate, Room { most: most * GIB, now: now * GIB });
        let said = judged(5, 5).unwrap_err().to_string();
        for part in ["6144 MiB", "5120 MiB", "surfels", "3072 MiB", "--voxels"] {
            assert!(said.contains(part), "{said}");
        }
        assert_eq!(judged(8, 8).unwrap(), None);
        let tight = judged(8, 7).unwrap().unwrap();
        assert!(tight.code == "memory" && tight.message.contains("7168 MiB are free"), "{}", tight.message);
        assert!(judged(8, 1).unwrap().is_some(), "others may give memory back");
    }

    #[cfg(any(target_os = "linux", target_os = "macos", windows))]
    #[test]
    fn the_machine_tells_how_much_there_is() {
        let room = room().unwrap();
        assert!(room.most > 1 << 20 && room.now <= room.most.saturating_mul(2), "{room:?}");
        assert!(check(&Memory { texels: u64::MAX, ..Memory::default() }).is_err());
        assert!(check(&Memory::default()).is_ok());
    }
}
