import { readFileSync } from "node:fs";

const FOLDER = new URL("../../audioflinger_hook/monitor/static/try/", import.meta.url);

/** A module of the page that imports no other: by its text, as Node 18 takes a file .js for another kind of module. */
export const load = (name) => import(`data:text/javascript,${encodeURIComponent(readFileSync(new URL(name, FOLDER), "utf8"))}`);
