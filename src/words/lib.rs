//! The shared types: time, random numbers, keys, records of a run, rejected values, new files, plain text;
//! the files that the program carries, and the programs that it starts as processes.
//! Uses: no other chapter. Never: devices, the database, HTTP; files, except in `new_file`; processes, except
//! in `program`.

pub mod carried;
pub mod chance;
pub mod clock;
pub mod commit;
pub mod difference;
pub mod digest;
pub mod event;
pub mod file_kind;
pub mod ids;
pub mod journal;
pub mod locate;
pub mod near;
pub mod new_file;
pub mod plain;
pub mod priority;
pub mod problem;
pub mod program;
pub mod query_lines;
pub mod record;
pub mod state;
pub mod suspension;
pub mod syntax;
pub mod toml_words;
