//! Which services a client trusts: TLS of requests and WebSockets.
//! Uses: rustls with ring, the system's authorities. Never: a certificate that is not verified.

use std::io;
use std::path::Path;
use std::sync::Arc;

use rustls::client::WebPkiServerVerifier;
use rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use rustls::crypto::{CryptoProvider, ring};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, ServerName, UnixTime};
use rustls::{ClientConfig, DigitallySignedStruct, Error, RootCertStore, SignatureScheme};
use rustls_platform_verifier::Verifier;

use super::error::{CliError, CliResult};
use crate::problem::Problem;

/// Certificates in PEM, with a name for messages.
#[derive(Debug, Clone)]
pub struct Certificates {
    /// Name of their file.
    pub name: String,
    /// Text of the file, PEM.
    pub pem: Vec<u8>,
}

impl Certificates {
    /// Reads a file.
    ///
    /// # Errors
    /// `CliError::Problems` if it cannot be read.
    pub fn read(path: &Path) -> CliResult<Self> {
        let pem = std::fs::read(path).map_err(CliError::input(path))?;
        Ok(Self { name: path.display().to_string(), pem })
    }

    fn parse(&self) -> CliResult<Vec<CertificateDer<'static>>> {
        let invalid = |words: String| CliError::from(Problem::whole(&self.name, words));
        match CertificateDer::pem_slice_iter(&self.pem).collect() {
            Err(error) => Err(invalid(format!("must be PEM: {error}"))),
            Ok(none) if Vec::is_empty(&none) => Err(invalid("has no certificate".into())),
            Ok(some) => Ok(some),
        }
    }
}

/// TLS for the service at a URL. With certificates only these are trusted, as those of the service or of
/// its authority; without them the authorities of the system. Nothing is read for `http://`.
///
/// # Errors
/// `CliError::Problems` if there is no certificate; `Tls` if the system has no authorities.
pub fn tls(url: &str, ca: Option<&Certificates>) -> CliResult<ClientConfig> {
    let provider = Arc::new(ring::default_provider());
    let builder = ClientConfig::builder_with_provider(provider.clone())
        .with_safe_default_protocol_versions()?;
    if !url.starts_with("https:") {
        return Ok(builder.with_root_certificates(RootCertStore::empty()).with_no_client_auth());
    }
    let verifier: Arc<dyn ServerCertVerifier> = match ca {
        Some(ca) => Arc::new(Known::new(ca.parse()?, provider)?),
        None => Arc::new(Verifier::new(provider)?),
    };
    Ok(builder.dangerous().with_custom_certificate_verifier(verifier).with_no_client_auth())
}

/// An HTTP client with this TLS. A rig is on the local network: proxies are not used.
///
/// # Errors
/// An error of reqwest if the client cannot be created.
pub fn http(tls: ClientConfig) -> Result<reqwest::Client, reqwest::Error> {
    reqwest::Client::builder().no_proxy().tls_backend_preconfigured(tls).build()
}

/// Returns why a certificate was not trusted, if that is the cause of an error.
pub fn refused(error: &(dyn std::error::Error + 'static)) -> Option<String> {
    let mut causes = std::iter::successors(Some(error), |error| error.source());
    causes.find_map(|cause| {
        // What an error of this kind wraps is not its source.
        let mut inner = cause;
        while let Some(wrapped) = inner.downcast_ref::<io::Error>().and_then(io::Error::get_ref) {
            inner = wrapped;
        }
        let tls = inner.downcast_ref::<Error>();
        tls.filter(|tls| matches!(tls, Error::InvalidCertificate(_))).map(ToString::to_string)
    })
}

/// Trusts the services that show one of these certificates, whatever its name and date, and those whose
/// certificate one of them has signed.
#[derive(Debug)]
struct Known {
    certificates: Vec<CertificateDer<'static>>,
    chains: Arc<WebPkiServerVerifier>,
}

impl Known {
    fn new(
        certificates: Vec<CertificateDer<'static>>,
        provider: Arc<CryptoProvider>,
    ) -> CliResult<Self> {
        let mut roots = RootCertStore::empty();
        for certificate in &certificates {
            roots.add(certificate.clone())?;
        }
        let chains = WebPkiServerVerifier::builder_with_provider(Arc::new(roots), provider).build();
        let chains = chains.map_err(|error| Error::General(error.to_string()))?;
        Ok(Self { certificates, chains })
    }
}

impl ServerCertVerifier for Known {
    fn verify_server_cert(
        &self,
        own: &CertificateDer<'_>,
        between: &[CertificateDer<'_>],
        name: &ServerName<'_>,
        status: &[u8],
        now: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        // The signature of the handshake proves that the service has its key.
        match self.certificates.contains(own) {
            true => Ok(ServerCertVerified::assertion()),
            false => self.chains.verify_server_cert(own, between, name, status, now),
        }
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        self.chains.verify_tls12_signature(message, certificate, signed)
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        self.chains.verify_tls13_signature(message, certificate, signed)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.chains.supported_verify_schemes()
    }
}
