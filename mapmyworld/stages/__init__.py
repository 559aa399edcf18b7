"""The stages of a build, one file each; `mapmyworld.pipeline` puts them in order."""
