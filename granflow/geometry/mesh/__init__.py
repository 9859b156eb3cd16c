"""Triangle meshes: reading, topology, contact ownership of facets, edges and corners, cell grid."""
