//! TLS of the service's own: certificate and key as files, read once at the start.
//! Uses: rustls with ring. Never: a file that is read while the service runs; a key in a message.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustls::ServerConfig;
use rustls::crypto::ring;
use rustls::pki_types::pem::{self, PemObject};
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::TlsAcceptor;

/// Files of a certificate and its key, PEM.
#[derive(Debug, Clone)]
pub struct Tls {
    /// The certificate, followed by those of the authorities between it and the root.
    pub certificate: PathBuf,
    /// The private key.
    pub key: PathBuf,
}

/// Why the certificate or its key cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{option} = {}: {cause}", path.display())]
pub struct TlsError {
    /// The option that names the file.
    pub option: &'static str,
    /// Path of the file.
    pub path: PathBuf,
    /// What is wrong with it.
    #[source]
    pub cause: TlsCause,
}

/// What is wrong with a file of a certificate or a key.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message names the fields")]
pub enum TlsCause {
    #[error("cannot be read")]
    Read(#[source] io::Error),
    #[error("must be PEM")]
    Pem(#[source] pem::Error),
    #[error("has no certificate: must be PEM with the line BEGIN CERTIFICATE")]
    NoCertificate,
    #[error("has no private key: must be PEM with a line BEGIN .. PRIVATE KEY, not encrypted")]
    NoKey,
    /// The key does not belong to the certificate, or is of a kind that is not supported.
    #[error("does not fit the certificate of --tls-cert")]
    Unfit(#[source] rustls::Error),
}

impl Tls {
    /// Reads both files.
    ///
    /// # Errors
    /// `TlsError` if a file cannot be read, has no certificate or key, or if the key does not fit.
    pub fn acceptor(&self) -> Result<TlsAcceptor, TlsError> {
        let of_certificate =
            |cause| TlsError { option: "--tls-cert", path: self.certificate.clone(), cause };
        let of_key = |cause| TlsError { option: "--tls-key", path: self.key.clone(), cause };
        let chain: Result<Vec<_>, _> = CertificateDer::pem_file_iter(&self.certificate)
            .and_then(Iterator::collect)
            .map_err(|error| of_certificate(cause(error, TlsCause::NoCertificate)));
        let chain = match chain? {
            chain if chain.is_empty() => return Err(of_certificate(TlsCause::NoCertificate)),
            chain => chain,
        };
        let key = PrivateKeyDer::from_pem_file(&self.key)
            .map_err(|error| of_key(cause(error, TlsCause::NoKey)))?;
        warn_if_others_may_read(&self.key);
        let unfit = |error| of_key(TlsCause::Unfit(error));
        let mut config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()
            .map_err(unfit)?
            .with_no_client_auth()
            .with_single_cert(chain, key)
            .map_err(unfit)?;
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        Ok(TlsAcceptor::from(Arc::new(config)))
    }
}

/// Converts an error of the PEM reader; `none` is the cause if the file has no item of the kind.
fn cause(error: pem::Error, none: TlsCause) -> TlsCause {
    match error {
        pem::Error::Io(error) => TlsCause::Read(error),
        pem::Error::NoItemsFound => none,
        other => TlsCause::Pem(other),
    }
}

/// Warns if other users of this machine may read a file with a secret.
pub fn warn_if_others_may_read(path: &Path) {
    use std::os::unix::fs::PermissionsExt;
    if let Ok(about) = path.metadata()
        && about.permissions().mode() & 0o007 != 0
    {
        let path = path.display();
        tracing::warn!(%path, "other users may read this file with a secret: chmod 600 it");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::journal::error_chain;

    #[test]
    fn a_refusal_names_option_file_and_cause() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = temporary.path().to_owned();
        let made = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
        let other = rcgen::KeyPair::generate().unwrap();
        let file = |name: &str, text: &str| {
            std::fs::write(folder.join(name), text).unwrap();
            folder.join(name)
        };
        let (certificate, key) = (
            file("cert.pem", &made.cert.pem()),
            file("key.pem", &made.signing_key.serialize_pem()),
        );
        let (foreign, text) =
            (file("other.pem", &other.serialize_pem()), file("text.pem", "not PEM"));
        let read = |certificate: &PathBuf, key: &PathBuf| {
            Tls { certificate: certificate.clone(), key: key.clone() }.acceptor()
        };
        assert!(read(&certificate, &key).is_ok());
        let missing = folder.join("missing.pem");
        for (certificate, key, option, file, words) in [
            (&missing, &key, "--tls-cert", &missing, "No such file"),
            (&certificate, &missing, "--tls-key", &missing, "No such file"),
            (&folder, &key, "--tls-cert", &folder, "directory"),
            (&text, &key, "--tls-cert", &text, "has no certificate"),
            (&key, &key, "--tls-cert", &key, "has no certificate"),
            (&certificate, &text, "--tls-key", &text, "has no private key"),
            (&certificate, &certificate, "--tls-key", &certificate, "has no private key"),
            (&certificate, &foreign, "--tls-key", &foreign, "does not fit the certificate"),
        ] {
            let refused = error_chain(&read(certificate, key).err().unwrap());
            let begin = format!("{option} = {}: ", file.display());
            assert!(refused.starts_with(&begin) && refused.contains(words), "{refused}");
        }
    }
}
