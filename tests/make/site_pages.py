"""Pages of the site that are no files beside the documents: the README, and the names of Python."""

from make.places import ROOT


def on_files(files, config):
    """Add them, as MkDocs asks for them; the README is read from the folder of the documents."""
    from mkdocs.structure.files import File

    readme = (ROOT / "README.md").read_text("utf-8").replace("](quatprop/docs/", "](")
    names = "# Names of Python\n\n::: quatprop\n"
    for name, content in (("index.md", readme), ("python.md", names)):
        files.append(File.generated(config, name, content=content))
    return files
