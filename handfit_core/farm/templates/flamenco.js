// A job type of Flamenco 3 for one plan: put this file into the folder `scripts` beside flamenco-manager.
const JOB_TYPE = {
    label: @title@,
    description: "Captures the hands of a plan's inputs, and reports what came of them",
    settings: [
        { key: "plan", type: "string", subtype: "file_path", required: true, default: @plan@,
          description: "The plan's file, as the workers find it" },
        { key: "program", type: "string", required: true, default: @program@,
          description: "What does the tasks: Blender, or a Python" },
    ]
};

const ARGUMENTS = @arguments@;
const OPTIONS = @options@;
// Name, numbers of the plan's tasks, and the places in this list of what must be done before.
const JOBS = @named@;

function compileJob(job) {
    const settings = job.settings;
    const author_task = function (name, words) {
        const task = author.Task(name, "misc");
        task.addCommand(author.Command("exec", {
            exe: settings.program,
            args: ARGUMENTS.concat(words),
        }));
        return task;
    };
    const report = author_task("report", ["collect", settings.plan]);
    const tasks = [];
    for (const [name, numbers, after] of JOBS) {
        // An input that cannot be captured is no reason to give up the others: the report tells of it.
        const words = ["task", settings.plan, numbers, "--accept-failed"].concat(OPTIONS);
        const task = author_task(name, words);
        for (const place of after) {
            task.addDependency(tasks[place]);
        }
        report.addDependency(task);
        tasks.push(task);
        job.addTask(task);
    }
    job.addTask(report);
}
