"""Page in the browser: local server, tiles of the points, static files of the client (sources in `page/`)."""
