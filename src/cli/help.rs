//! What the help of every command says below its options: examples, events, exit codes.

pub const ABOUT: &str = "Bakes light into glTF levels: lightmaps, no GPU, no editor.";

pub const EXAMPLES: &str = "\
Examples:
  luxel bake level.glb                          lightmap, lit .glb, picture and report in baked/
  luxel bake level.glb --preset draft           a first look
  luxel bake level.glb --sky 300,400,600        with a blue sky of 300..600 cd/m²
  luxel bake level.glb --sky noon.hdr           with an image as the sky
  luxel bake levels/ --out lit/                 every scene below a folder, several at a time
  luxel bake levels/ --check                    bakes nothing; exit code 3 when a lightmap is not current
  luxel bake level.glb --verify 500             with its error against the reference at 500 texels
  luxel bake levels/ --max-error 2%             a gate: exit code 1 where a lightmap is not certainly that good
  luxel plan level.glb                          what would run, and why
  luxel watch levels/                           bakes, and again whatever is saved
  luxel watch level.glb --preview               the same, shown in the browser

A scene is left alone when its report says that it was baked from the same bytes, with the same settings, by the same
luxel, and when all its outputs are as they were written; --force bakes it all the same. With --verify its report also
has to tell of a verification of so many texels: then --max-error is judged by that, with --check too.

A verified lightmap is compared as it is written, at texels drawn by their area. Checks: no texel belongs to two charts;
no more than a tenth of the texels lies inside geometry; no texel that a closed wall separates from all light is lit;
the energy ledger balances within 1 % after the shooting, the refresh and the gather; no value is negative or no number.

Events of --json, one object per line, with their fields:
  unchanged    scene, outputs                     left alone: its outputs are current; with --verify as baked
  stale        scene, reasons                     they are not; each reason has a code and a message
  started      scene, stage, total                a stage begins
  progress     scene, stage, done, total
  finished     scene, stage, seconds
  plan         scene, plan, unchanged, stale      of luxel plan; stale holds the reasons
  baked        scene, seconds, outputs, quality, warnings   with --verify also verification, checks, as in the report
  failed       scene, error, causes               its last good outputs stay; with --max-error as baked
  done         scenes, failed, unchanged, stale   the last event: a number, and lists of scenes
  interrupted  scene, scenes, failed              the last event after Ctrl-C; scenes were being baked, scene is the first
  usage        error, causes                      the last event of a command line that could not be followed

Exit codes: 0 done, 1 some scenes failed, 2 wrong usage, 3 --check found something stale (and nothing failed), 130
interrupted.";

pub const WATCHING: &str = "\
Bakes every scene whose outputs are not current, and again whenever a file changes that its last bake read: the .gltf or
.glb, buffers, images, the sky, luxel.toml. A bake that is overtaken by a change stops and starts anew; a file that is
saved without a change bakes nothing; a scene that cannot be baked says why and keeps what was baked last. New scenes in
watched folders are baked too.

Where light has to be gathered anew, a draft comes first: the same files with the same UVs, lit coarsely, without a
picture. The bake replaces it; until one ends well, the draft is what lies there. --check calls it stale, and its report says what it is.

Examples:
  luxel watch level.glb --preset draft          lightmap anew after every save
  luxel watch levels/ --out lit/                every scene below a folder
  luxel watch //server/levels --poll 5          looks every 5 seconds: for drives that tell of no changes
  luxel watch level.glb --preview               serves a page that shows the level and every new lightmap
  luxel watch level.glb --json                  for programs: one event per line

Network drives and folders that the system cannot watch are looked at every 2 seconds without being asked for.

The page of --preview is for browsers on this machine: it comes from 127.0.0.1 and shows outputs of bakes, nothing else.
It shows the level lit, its lightmap alone, albedo, texel density, charts and invalid texels (keys 1 to 6). It is part
of a luxel that was built after it was (npm ci && npm run build in assets/preview); without it, luxel says so and bakes.

Events of --json, one object per line, with their fields:
  preview    url, notice             with --preview: its address, and what is missing, or null
  watching   paths, scenes           once, at the start
  waiting    scene, outputs          after that, each scene; the report of its last bake, if there is one
  polling    folder, reason, seconds nobody tells of changes there, so it is looked at
  unwatched  path, reason            it cannot be watched or searched
  found      scene                   a new scene
  changed    scene, files            other content than before; no files where only settings changed
  moved      scene, glb              other names for its outputs, for there is another scene of its name, or no more
  lost       scene, files            outputs that were current have gone, so it is baked again
  unchanged  scene, files            touched, with the content of before
  removed    scene                   its outputs stay
  baking     scene                   then stages as of luxel bake --json: started, progress, finished
  drafted    scene, seconds, outputs, quality, warnings    a draft lies there until the bake ends
  overtaken  scene                   stopped, because its files changed; another bake follows unless they changed back
  baked      scene, seconds, outputs, quality, warnings
  failed     scene, error, causes, draft   its outputs stay: a draft (true), a bake's (false), or there are none (null)
  current    scene, outputs          as when it was baked: at the start, or again after it was broken
  unshown    scene, error, causes    the preview cannot show its outputs
  idle       scenes, failed, draft   everything is as current as it can be; draft: whose outputs are drafts
  stopped    scenes, failed, draft   the last event
  usage      error, causes           the last event of a command line that could not be followed

Ctrl-C ends it, after the running bake has stopped; a second one, half a second later, ends it at once.
Exit codes: 0 ended, 1 ended with scenes that could not be baked, 2 wrong usage, 130 ended by a second Ctrl-C.";

pub const MIXING: &str = "\
Lights of one name (of their node, or its extra luxel_group) are one group; the sky is the group sky. luxel plan lists
them. Their light is taken from the store of a bake with the same settings: give the options that the bake had, --out
and --store among them. Where it is not there, the scene fails and says so.

Examples:
  luxel export level.glb --mix sun=0.2,lamps=1.5      dusk, in mixed/
  luxel export level.glb --mix lamps=0 --to day/      the lamps off
  luxel export levels/ --mix sun=0 --to night/        every scene below a folder that has a group sun

Events of --json are those of luxel bake.

Exit codes: 0 done, 1 some scenes failed, 2 wrong usage, 130 interrupted.";

pub const RENDERING: &str = "\
The picture of a scene from a camera: NAME.render.png as it is displayed and NAME.render.exr as radiance (cd/m², linear
Rec. 709, 32 bit, A = 1), beside the scene's outputs in baked/ or --out DIR. Nothing of a bake is written, but for the
store, in which a picture uses and leaves what bakes with the same settings do. Surfaces are Lambertian: L = Le + ρE/π.

Methods:
  lightcuts    the voxel solution, gathered by lightcuts at every point, direct light and sky exactly
  lightmap     the lightmap of a bake, which is made where the store does not have it
  lookup       the voxel solution, interpolated
  final        the voxel solution, by a final gather
  samples      the voxel solution, by random sample voxels: the picture gets better pass by pass
  voxels       the voxels of the solution, shown directly
  photons      photon mapping, gathered by lightcuts
  paths        path tracing: the reference, without bias, with noise

All but lightmap show all light, whatever a lightmap would hold: --only is for the lightmap alone. No picture replaces a
file that its scene is made from.

Every pixel has 4 samples, and all --aa N where what is displayed differs between its samples or from its neighbours, or
where they show other surfaces. The method samples, and with --progressive or --time the method paths, write a first picture
soon and again whenever they have drawn twice as much, until that is spent or the time is over; how far they come in a
given time depends on the machine, what they show then does not.

Examples:
  luxel render level.glb                                        from its camera, by lightcuts
  luxel render level.glb --camera Door --width 1920             another camera, by its name or number
  luxel render level.glb --eye 1,1.7,4 --target 0,1,0 --fov 60  from anywhere
  luxel render level.glb --method lightmap --to lit.png         what an engine shows with the lightmap
  luxel render level.glb --method paths --paths 1000 --time 60  the reference, as far as a minute takes it
  luxel render level.glb --compare photons,lightcuts,paths      side by side, with differences to the last
  luxel render levels/ --out pictures/ --exposure 7             every scene below a folder, at one exposure

--compare writes NAME.compare.png: every method's picture at one exposure, and below each its difference to the last one,
or to --against, in false colour (red is brighter), with RMSE and bias, wall-clock time of all that the method needs, and
the rays that it traces for it. For that, nothing is taken from the store. Differences are of what surfaces reflect, in % of
its mean: what shines itself, and the sky behind, are in the pictures but no difference.

Events of --json, one object per line, with their fields:
  started, progress, finished                          stages, as of luxel bake
  pass         scene, method, pass, draws, seconds, error, outputs    of samples; of paths with --progressive or --time
  rendered     scene, method, draws, seconds, width, height, samples, points, rays, error, exposure, outputs, warnings
  compared     scene, against, width, height, exposure, reflected, methods, outputs, warnings   of --compare; each of the
                                                       methods has method, draws, seconds, samples, points, rays,
                                                       error, rmse, bias, p95
  failed       scene, error, causes                    no picture of it was written
  done         scenes, failed, unchanged, stale        the last event
  interrupted  scene, scenes, failed                   the last event after Ctrl-C
  usage        error, causes                           the last event of a command line that could not be followed
draws are those of a method that draws at random, or null; error is its estimated standard error, and as rmse, bias and
p95, which are of the reflected radiance, a share of its mean, or null; exposure in EV at ISO 100; reflected in cd/m².

Exit codes: 0 done, 1 some scenes failed, 2 wrong usage, 130 interrupted.";

pub const CACHING: &str = "\
A bake keeps the result of every stage under the digest of all that it follows from, so that the next one makes only
what has changed. Everything in a store can be made again: removing it costs time and nothing else. A bake keeps its
store below a cap by itself, sparing what was used within an hour as long as it is below twice that. The cap belongs to
the store: --store-cap of a bake and --cap of gc set it, in the store's file cap, and it holds for everybody who gives
none.

Examples:
  luxel cache stat                              the stores below this folder
  luxel cache stat levels/ --json               for programs
  luxel cache verify level.glb                  the store beside its outputs in baked/
  luxel cache gc levels/ --cap 2GiB --older 30d
  luxel cache gc --store /srv/luxel --cap 50GiB a store that machines share
  luxel cache gc --cap 0                        empties the stores below this folder

gc removes, first, what is damaged or of an earlier luxel's format, what nobody has used for --older, and temporary
files of killed bakes when they are older than an hour; then the least recently used results beyond --cap. It may run
while others bake: what they miss they make again. Other files in a store's folder are never touched.

Events of --json, one object per line, with their fields; sizes in bytes, times in seconds since 1970:
  stat       store, cap, kept, total, kinds, leftovers, old   cap: bytes, kept: whether it was ever given; of the
                                                   others each has files, bytes, oldest, newest (times of last use)
  outdated   store, file, reason                   of verify: in another luxel's format
  bad        store, file, reason                   of verify: damaged
  verified   store, sound, outdated, bad           numbers of files
  collected  store, evicted, bad, outdated, leftovers, left, failed   each with files, bytes; failed holds file, reason
  failed     store, error, causes                  it cannot be looked through
  done       stores, failed, bad                   the last event: numbers
  usage      error, causes                         the last event of a command line that could not be followed

Exit codes: 0 done, 1 verify found something damaged, or a store could not be read or cleaned, 2 wrong usage.";

pub const REPORTING: &str = "\
Every point of a report is one way to find the scene's light: a bake with one setting changed, all of them refined
together, or another method. Its light is compared with the reference path tracer at some hundred texels, drawn evenly by
area. Written beside the scene, in report/, or to --out:

  NAME.report.csv   every point: seconds, rays, RMSE, relMSE, bias, percentiles, direct and indirect apart
  NAME.report.md    the same for people, with the laws by which errors fall, what limits the error, and Table 1
  NAME.report.json  laws, advice, Table 1, for programs
  NAME.front.svg    error against processor time of every method, with the Pareto front
  NAME.sweeps.svg   error against each setting
  NAME.maps.png     the atlas: baked, reference, difference

What was measured is kept in a store beside them, the reference too: an interrupted report goes on where it stopped, and
one with more sweeps measures only what is new. Atlases have 128 texels a side unless --size says otherwise.

Examples:
  luxel report level.glb                          everything, with the settings as they are
  luxel report level.glb --sweep voxels,cut_error two settings alone
  luxel report level.glb --sweep none             the methods of the paper's Figure 3, and all settings together
  luxel report level.glb --methods paths,photons  two methods beside the settings
  luxel report level.glb --target-error 2%        the settings for an error; luxel bake --target-error 2% uses them
  luxel report level.glb --target-time 30s        the settings for a time on this machine

Events of --json, one object per line, with their fields, besides those of stages (luxel bake --help):
  point    scene, point                           one measurement
  report   scene, findings, files                 laws, advice, Table 1; what was written
  target   scene, rung, flags, rmse, rmse_most, seconds, reached

Exit codes: 0 done, 1 some scenes failed or their target is out of reach, 2 wrong usage, 130 interrupted.";
