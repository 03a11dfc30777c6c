"""Messages between processes and the files of demonstrations: columns, encoding, sockets, delivery and scoring."""
