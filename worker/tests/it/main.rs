//! Tests of the whole program on a PostgreSQL that they start; without `postgres` they fail if
//! PALPATE_REQUIRE_TOOLS is set, and report that they were skipped otherwise.

mod bench;
mod crash;
mod flow;
mod poison;
mod proxy;
mod rights;
mod s3;
mod server;
mod thousand;
