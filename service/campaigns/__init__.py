"""What campaigns do with their items, in vehicles, in uploads and in an archive of files."""
