// SPDX-License-Identifier: GPL-3.0-or-later
// Flamenco 3 job type: a vibration dataset, rendered in parts. Copy this file into the folder `scripts` beside the
// flamenco-manager executable and restart the manager. Workers need a Python with tg4mm and bpy, and the same file
// system. Plain ES5, without arrows or templates.

var JOB_TYPE = {
    label: "tg4mm vibration dataset",
    description: "Renders a vibrating scene from many cameras, with exact ground truth of the motion",
    settings: [
        { key: "scene", type: "string", default: "",
          description: "A built-in scene (mic, ship, …); empty: this .blend file" },
        { key: "motion", type: "string", subtype: "file_path", default: "",
          description: "YAML description of how it moves; needed for a .blend file" },
        { key: "options", type: "string", default: "--preset paper",
          description: "Further options, as on the command line of python -m dataset_gen" },
        { key: "out", type: "string", subtype: "dir_path", required: true,
          eval: "str(Path(abspath('//')) / 'datasets')",
          evalInfo: { showLinkButton: true, description: "beside the .blend file" },
          description: "Parent folder of the dataset; all workers see it under this name" },
        { key: "parts", type: "int32", default: 8, propargs: { min: 1, max: 1000 },
          description: "Number of render tasks" },
        { key: "processes", type: "int32", default: 0, propargs: { min: 0, max: 256 }, visible: "submission",
          description: "Render processes at once in each task; 0: one per core of the worker" },
        { key: "python", type: "string", default: "python3", visible: "submission",
          description: "Python with tg4mm and bpy, on the workers; may be a Flamenco variable such as {tg4mm_python}" },
        { key: "blendfile", type: "string", eval: "bpy.data.filepath", visible: "web",
          description: "The .blend file, if no scene is named" },
    ],
};

function compileJob(job) {
    var settings = job.settings;
    var parts = settings.parts;
    if (parts !== Math.floor(parts) || parts < 1) {
        throw new Error("parts is " + parts + ", expected a whole number of at least 1");
    }
    var base = ["-m", "dataset_gen"].concat(sourceArguments(settings), splitWords(settings.options || ""),
        ["--out", settings.out]);

    // A task is copied when it is added to the job: commands and dependencies come first.
    var prepare = authorTask(settings, "prepare", "misc", base.concat(["--prepare", "--parts", String(parts)]));
    job.addTask(prepare);

    var rendered = [];
    for (var i = 1; i <= parts; i++) {
        var what = i + "/" + parts;
        var task = authorTask(settings, "render-" + what, "blender",
            base.concat(["--part", what, "--processes", String(settings.processes || 0)]));
        task.addDependency(prepare);
        job.addTask(task);
        rendered.push(task);
    }

    var finish = authorTask(settings, "finish", "misc", base.concat(["--finish"]));
    for (var k = 0; k < rendered.length; k++) {
        finish.addDependency(rendered[k]);
    }
    job.addTask(finish);
}

function authorTask(settings, name, type, args) {
    var task = author.Task(name, type);
    task.addCommand(author.Command("exec", { exe: settings.python || "python3", args: args }));
    return task;
}

// What is rendered: a built-in scene, or the .blend file that the job was submitted from.
function sourceArguments(settings) {
    var motion = settings.motion ? ["--motion", settings.motion] : [];
    if (settings.scene) {
        return [settings.scene].concat(motion);
    }
    if (!settings.blendfile) {
        throw new Error("name a scene, or save the .blend file first");
    }
    if (!settings.motion) {
        throw new Error("motion is empty: a .blend file needs a description of how it moves");
    }
    return ["--blend", settings.blendfile].concat(motion);
}

// Words apart at blanks; "…" and '…' keep blanks, as in a shell. Nothing is expanded.
function splitWords(text) {
    var words = [], word = "", inside = "", begun = false;
    for (var i = 0; i < text.length; i++) {
        var c = text.charAt(i);
        if (inside) {
            if (c === inside) {
                inside = "";
            } else {
                word += c;
            }
        } else if (c === '"' || c === "'") {
            inside = c;
            begun = true;
        } else if (c === " " || c === "\t" || c === "\n") {
            if (begun) {
                words.push(word);
            }
            word = "";
            begun = false;
        } else {
            word += c;
            begun = true;
        }
    }
    if (inside) {
        throw new Error("options: the quote " + inside + " is not closed");
    }
    if (begun) {
        words.push(word);
    }
    return words;
}
