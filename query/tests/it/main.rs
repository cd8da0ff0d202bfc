//! Tests of the program `palpate-query` as the service uses it: lines in, rows out.
//! Uses: the built program, Parquet files that the tests write. Never: the service.

mod common;
mod hostile;
mod mistakes;
mod page;
mod process;
mod tables;
