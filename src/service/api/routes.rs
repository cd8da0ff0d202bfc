//! The table of operations: for each what it needs before its handler runs. The router, the checks
//! of `guard`, `openapi.yaml` and the tests follow from it.
//! Uses: the handlers. Never: a route that is not in the table, apart from pages.

use std::collections::HashMap;

use axum::http::Method;
use utoipa_axum::router::UtoipaMethodRouter;
use utoipa_axum::routes;

use super::access::{Access, Edited, Lock, Needs};
use super::limits::{
    ACTION_BODY_MAX_BYTES, BODY_MAX_BYTES, FRAMES_MAX_BYTES, IMPORT_MAX_BYTES, MODEL_MAX_BYTES,
};
use super::{
    App, datasets, estop, evaluation, events, experiments, exports, forces, gather, health,
    history, imports, infer, jobs, live, live_contacts, live_status, models, overlay, people,
    placement, preflight, progress, published, quantities, queue, queue_times, rates, readings,
    recipes, recording, rig, rig_limits, runs, samples, sensor, simulations, sql, status, tour,
    trials, twins, untouched, vocabulary, wear, workers,
};
use crate::store::Role;

/// An operation, or several of one path with the same needs.
pub struct Operation {
    /// Rights and locks that the operation needs.
    pub needs: Needs,
    /// Description, path and handler.
    pub route: UtoipaMethodRouter<App>,
}

const READS: Needs = Needs {
    access: Access::From(Role::Viewer),
    lock: Lock::Ignored,
    action: None,
    body_max_bytes: BODY_MAX_BYTES,
    socket: false,
    once: false,
    moves: false,
    edited: None,
};
const SOCKET: Needs = Needs { socket: true, ..READS };

/// An action that the operator lock of another person refuses.
const fn acts(action: &'static str) -> Needs {
    Needs {
        access: Access::From(Role::Operator),
        lock: Lock::Refuses,
        action: Some(action),
        body_max_bytes: ACTION_BODY_MAX_BYTES,
        ..READS
    }
}

impl Needs {
    const fn role(self, role: Role) -> Self {
        Self { access: Access::From(role), ..self }
    }

    const fn access(self, access: Access) -> Self {
        Self { access, ..self }
    }

    const fn lock(self, lock: Lock) -> Self {
        Self { lock, ..self }
    }

    const fn body(self, body_max_bytes: usize) -> Self {
        Self { body_max_bytes, ..self }
    }

    const fn once(self) -> Self {
        Self { once: true, ..self }
    }

    const fn moves(self) -> Self {
        Self { moves: true, ..self }
    }

    const fn of(self, edited: Edited) -> Self {
        Self { edited: Some(edited), ..self }
    }
}

/// Returns all operations.
#[rustfmt::skip]
pub fn table() -> Vec<Operation> {
    use Role::{Admin, Viewer};
    let rows: Vec<(Needs, UtoipaMethodRouter<App>)> = vec![
        (READS, routes!(status::status)),
        (SOCKET, routes!(live_status::live)),
        (READS.of(Edited::Queue), routes!(queue::list)),
        (acts("queue").body(BODY_MAX_BYTES).once().of(Edited::Queue), routes!(queue::add)),
        (acts("edit").body(BODY_MAX_BYTES).of(Edited::Queue), routes!(queue::edit)),
        (acts("remove").of(Edited::Queue), routes!(queue::remove)),
        (acts("move").of(Edited::Queue), routes!(queue::shift)),
        (READS, routes!(queue_times::times)),
        (READS.role(Role::Operator), routes!(preflight::of_submission)),
        (READS.role(Role::Operator), routes!(tour::of_submission)),
        (READS, routes!(experiments::list)),
        (READS, routes!(experiments::schema)),
        (READS.body(ACTION_BODY_MAX_BYTES), routes!(simulations::simulate)),
        (READS, routes!(runs::list)),
        (READS, routes!(runs::one)),
        (READS, routes!(runs::summary)),
        (READS, routes!(preflight::of_run)),
        (READS, routes!(runs::plan)),
        (READS, routes!(tour::of_run)),
        (READS, routes!(progress::of_run)),
        (READS, routes!(forces::of_run)),
        (READS, routes!(history::of_run)),
        (READS, routes!(sensor::sensor)),
        (acts("arm"), routes!(runs::arm)),
        // Any valid key may stop a run.
        (acts("run_action").role(Viewer).lock(Lock::RefusesSome).moves(), routes!(runs::act)),
        (READS, routes!(placement::placement)),
        (READS, routes!(overlay::overlay)),
        (READS, routes!(trials::of_run)),
        (READS, routes!(trials::all)),
        (READS, routes!(trials::groups)),
        (READS, routes!(trials::one)),
        (READS, routes!(trials::frames)),
        (READS, routes!(trials::bench_records)),
        (READS, routes!(twins::all)),
        (READS, routes!(twins::of_run)),
        (READS, routes!(twins::inputs)),
        (acts("store twins").body(FRAMES_MAX_BYTES), routes!(twins::store)),
        (READS, routes!(workers::all)),
        (acts("submit an order").lock(Lock::Ignored), routes!(workers::submit)),
        (acts("gather an order").lock(Lock::Ignored), routes!(gather::gather)),
        (acts("cancel an order").lock(Lock::Ignored), routes!(workers::cancel)),
        (READS, routes!(evaluation::simulation)),
        (READS, routes!(datasets::list)),
        (acts("make a dataset").body(BODY_MAX_BYTES).once(), routes!(datasets::make)),
        (READS, routes!(datasets::one)),
        (READS, routes!(datasets::lineage)),
        (READS, routes!(datasets::card)),
        (READS, routes!(datasets::package)),
        (acts("prune datasets"), routes!(datasets::prune)),
        (READS, routes!(datasets::rows)),
        (READS, routes!(datasets::groups)),
        (READS, routes!(datasets::data)),
        (READS.body(BODY_MAX_BYTES), routes!(sql::ask)),
        (READS, routes!(sql::asked)),
        (READS, routes!(sql::tables)),
        (READS, routes!(exports::list)),
        // An export reads rows: viewers may, and no lock prevents it.
        (acts("export").role(Viewer).lock(Lock::Ignored).once(), routes!(exports::request)),
        (READS, routes!(exports::one)),
        (READS, routes!(exports::file)),
        (acts("import").body(IMPORT_MAX_BYTES), routes!(imports::add)),
        (READS, routes!(recipes::list)),
        (READS, routes!(published::published)),
        (acts("train").body(BODY_MAX_BYTES).once(), routes!(jobs::train)),
        (acts("evaluate").once(), routes!(jobs::evaluate)),
        (acts("order an evaluation"), routes!(readings::inputs)),
        (acts("score readings").body(FRAMES_MAX_BYTES), routes!(readings::score)),
        (READS, routes!(jobs::list)),
        (READS, routes!(jobs::one)),
        (READS, routes!(jobs::losses)),
        (acts("stop a job").lock(Lock::Ignored), routes!(jobs::stop)),
        (READS, routes!(models::list)),
        (READS, routes!(models::one)),
        (READS, routes!(models::onnx)),
        (READS, routes!(models::losses)),
        (READS, routes!(models::residuals)),
        (acts("add a model").body(MODEL_MAX_BYTES), routes!(models::add)),
        (acts("add a calibration").body(BODY_MAX_BYTES).once(), routes!(models::add_calibration)),
        (READS.of(Edited::Serving), routes!(models::serving)),
        (acts("promote").once().of(Edited::Serving), routes!(models::promote)),
        (acts("roll back").once().of(Edited::Serving), routes!(models::roll_back)),
        (READS.body(FRAMES_MAX_BYTES), routes!(infer::infer)),
        (READS.body(FRAMES_MAX_BYTES), routes!(quantities::quantities)),
        (SOCKET, routes!(live_contacts::live)),
        (SOCKET, routes!(quantities::live)),
        (READS, routes!(events::events)),
        (SOCKET, routes!(live::frames)),
        (READS, routes!(recording::record)),
        (READS, routes!(samples::last_minutes)),
        (READS, routes!(untouched::untouched)),
        (READS, routes!(wear::wear)),
        (READS, routes!(rig_limits::limits)),
        (READS, routes!(rates::rates)),
        (acts("rig_action").once().moves(), routes!(rig::act)),
        (acts("rig_check").once().moves(), routes!(rig::check)),
        // Any valid key may stop a motion.
        (acts("rig_abort").role(Viewer).lock(Lock::Stops), routes!(rig::abort)),
        (READS.of(Edited::Lock), routes!(people::lock)),
        // The lock itself: the handlers compare the holder.
        (acts("lock").lock(Lock::Ignored).of(Edited::Lock), routes!(people::take_lock)),
        (acts("unlock").lock(Lock::Ignored).of(Edited::Lock), routes!(people::clear_lock)),
        // A lock does not keep a key from being revoked.
        (READS.role(Admin), routes!(people::keys)),
        (acts("key").role(Admin).lock(Lock::Ignored), routes!(people::create_key)),
        (acts("revoke_key").role(Admin).lock(Lock::Ignored), routes!(people::revoke_key)),
        (READS, routes!(people::caller)),
        (READS, routes!(people::ticket)),
        (READS, routes!(people::actions)),
        (READS, routes!(vocabulary::vocabulary)),
        (READS, routes!(health::metrics)),
        (READS.access(Access::Open), routes!(health::live)),
        (READS.access(Access::Open), routes!(health::ready)),
        (acts("estop").access(Access::Stop).lock(Lock::Ignored), routes!(estop::estop)),
    ];
    rows.into_iter().map(|(needs, route)| Operation { needs, route }).collect()
}

/// Needs of each operation by method and path, such as `/api/v1/queue/{run}`.
#[derive(Debug)]
pub struct AllNeeds(HashMap<(Method, String), Needs>);

impl AllNeeds {
    /// Needs of the operations of a table.
    pub fn of(table: &[Operation]) -> Self {
        let mut all = HashMap::new();
        for Operation { needs, route } in table {
            for (path, item) in &route.1.paths {
                let methods = [
                    (Method::GET, item.get.is_some()),
                    (Method::PUT, item.put.is_some()),
                    (Method::POST, item.post.is_some()),
                    (Method::DELETE, item.delete.is_some()),
                ];
                for (method, _) in methods.into_iter().filter(|(_, exists)| *exists) {
                    all.insert((method, path.clone()), *needs);
                }
            }
        }
        Self(all)
    }

    /// Returns the needs of an operation; those of GET for HEAD.
    pub fn find(&self, method: &Method, path: &str) -> Option<&Needs> {
        let method = if *method == Method::HEAD { Method::GET } else { method.clone() };
        self.0.get(&(method, path.to_owned()))
    }

    /// Returns all operations with their needs.
    pub fn iter(&self) -> impl Iterator<Item = (&Method, &str, &Needs)> {
        self.0.iter().map(|((method, path), needs)| (method, path.as_str(), needs))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_stop_waits_for_an_edit_or_a_write_and_what_is_repeated_is_a_small_action() {
        let all = AllNeeds::of(&table());
        for (method, path, needs) in all.iter() {
            let stops = matches!(needs.lock, Lock::RefusesSome | Lock::Stops)
                || needs.access == Access::Stop;
            assert!(!stops || (!needs.once && needs.edited.is_none()), "{path}");
            // The commands find it by its method and address.
            let is_simple = *method == Method::POST && !path.contains('{');
            let is_small_action = needs.action.is_some() && needs.body_max_bytes <= BODY_MAX_BYTES;
            assert!(!needs.once || (is_simple && is_small_action), "{path}");
        }
        assert_eq!(all.iter().filter(|(.., needs)| needs.once).count(), 10);
    }
}
