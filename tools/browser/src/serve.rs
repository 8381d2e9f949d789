//! A static server for one folder, on the loopback.

use anyhow::{Context, Result, anyhow};
use std::fs::File;
use std::path::{Component, Path, PathBuf};
use tiny_http::{Header, Request, Response, Server};

/// Serves until the program ends.
pub fn serve(folder: &Path, port: u16) -> Result<()> {
    let server = listen(port)?;
    println!("http://localhost:{}/", port_of(&server)?);
    answer(&server, folder);
    Ok(())
}

/// Opens a port; 0 means any free one.
pub fn listen(port: u16) -> Result<Server> {
    Server::http(("127.0.0.1", port)).map_err(|error| anyhow!("cannot listen on port {port}: {error}"))
}

pub fn port_of(server: &Server) -> Result<u16> {
    let address = server.server_addr().to_ip().context("the server has no port")?;
    Ok(address.port())
}

/// Answers requests for files of the folder.
pub fn answer(server: &Server, folder: &Path) {
    for request in server.incoming_requests() {
        // A closed connection is no error.
        _ = respond(request, folder);
    }
}

fn respond(request: Request, folder: &Path) -> std::io::Result<()> {
    let path = file_of(request.url());
    match path.as_ref().and_then(|path| File::open(folder.join(path)).ok()) {
        Some(file) => {
            let kind = path.as_deref().map_or("", media_type);
            let header = Header::from_bytes("Content-Type", kind).expect("media types are ASCII");
            request.respond(Response::from_file(file).with_header(header))
        }
        None => request.respond(Response::empty(404)),
    }
}

/// The file for an address; `None` for one outside of the folder.
fn file_of(url: &str) -> Option<PathBuf> {
    let path = url.split('?').next()?.trim_start_matches('/');
    let path = PathBuf::from(if path.is_empty() { "index.html" } else { path });
    let is_inside = path.components().all(|part| matches!(part, Component::Normal(_)));
    is_inside.then_some(path)
}

fn media_type(path: &Path) -> &'static str {
    match path.extension().and_then(|end| end.to_str()) {
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript",
        Some("wasm") => "application/wasm",
        Some("png") => "image/png",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_files_of_the_folder_are_served() {
        assert_eq!(file_of("/?still=true"), Some("index.html".into()));
        assert_eq!(file_of("/demo.js"), Some("demo.js".into()));
        assert_eq!(file_of("/../Cargo.toml"), None);
    }
}
