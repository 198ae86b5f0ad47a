// Bundles src/ into page.html, one file that needs no network. Usage: node build.mjs [OUTPUT]
import { build } from "esbuild";
import { readFile, writeFile } from "node:fs/promises";

const bundle = await build({
  entryPoints: ["src/main.ts"],
  bundle: true,
  minify: true,
  write: false,
  format: "iife",
  target: "es2022",
  legalComments: "inline",
  outdir: "out",
  charset: "utf8",
});
const output = (ending) => bundle.outputFiles.find((file) => file.path.endsWith(ending)).text.trim();
const html = (await readFile("src/page.html", "utf8"))
  .replace("/* style */", () => output(".css"))
  .replace("/* script */", () => output(".js").replaceAll("</script", "<\\/script"));
await writeFile(process.argv[2] ?? "page.html", html);
