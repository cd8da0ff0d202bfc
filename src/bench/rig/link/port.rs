//! A port: what a wire is opened as.
//! Uses: tokio's io traits. Never: frames, how it is opened.

use std::fmt;

use tokio::io::{AsyncRead, AsyncWrite};

/// A byte stream in both directions.
pub trait Port: AsyncRead + AsyncWrite + Unpin + Send + fmt::Debug {}

impl<T: AsyncRead + AsyncWrite + Unpin + Send + fmt::Debug> Port for T {}
