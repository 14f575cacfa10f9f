"""What a person looks at: reports, pictures, films, recordings."""
