"""Style sheet of reports: light and dark screens, and print."""

STYLE = """
:root{--ink:#1b1f24;--soft:#5f6b7a;--faint:#e3e7ec;--page:#fff;--card:#f6f7f9;--before:#c4762b;--after:#1f6feb;
--good:#18794e;--bad:#b42318;--grid:#e3e7ec;color-scheme:light dark}
@media(prefers-color-scheme:dark){:root{--ink:#e8eaed;--soft:#9aa4b2;--faint:#2b313a;--page:#14171c;--card:#1c2027;
--before:#e09a52;--after:#6ea8ff;--good:#5ec28d;--bad:#f0806f;--grid:#2b313a}}
*{box-sizing:border-box}
body{margin:0 auto;padding:40px 28px 80px;max-width:1060px;background:var(--page);color:var(--ink);
font:15px/1.55 system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,sans-serif;
font-variant-numeric:tabular-nums}
header p.kicker{margin:0;color:var(--soft);font-size:13px;letter-spacing:.04em;text-transform:uppercase}
h1{margin:.15em 0 .6em;font-size:22px;font-weight:600;letter-spacing:-.01em}
p.verdict{margin:0 0 24px;font-size:20px;line-height:1.45;max-width:46em;text-wrap:pretty}
h2{margin:44px 0 6px;font-size:17px;font-weight:600}
h3{margin:22px 0 4px;font-size:14px;font-weight:600}
p.lead{margin:0 0 12px;color:var(--soft);max-width:52em}
.tiles{display:flex;flex-wrap:wrap;gap:12px}
.tile{flex:1 1 150px;padding:12px 16px;background:var(--card);border-radius:8px}
.tile b{display:block;font-size:22px;font-weight:600;letter-spacing:-.01em;white-space:nowrap}
.tile span{color:var(--soft);font-size:13px}
.alarm{margin:0 0 20px;padding:12px 16px;border-left:4px solid var(--bad);background:var(--card);border-radius:4px}
.wide{overflow-x:auto}
table{border-collapse:collapse;width:100%;font-size:13.5px}
table.narrow{width:auto;min-width:40%}table.narrow td.n,table.narrow th.n{padding-left:36px}
th{padding:5px 10px;border-bottom:1px solid var(--faint);color:var(--soft);font-weight:500;text-align:left;
vertical-align:bottom}
td{padding:5px 10px;border-bottom:1px solid var(--faint);vertical-align:top}
th.n,td.n{text-align:right;white-space:nowrap}
td.name{font-weight:500;white-space:nowrap}
td.why{color:var(--soft)}
tr.total td{font-weight:600;border-top:1px solid var(--soft)}
tr.taken td{background:color-mix(in srgb,var(--after) 9%,transparent)}
small,.soft{color:var(--soft);font-size:12.5px}
code{font:12.5px/1.4 ui-monospace,SFMono-Regular,Menlo,Consolas,monospace}
.good{color:var(--good)}.bad{color:var(--bad)}
.beside{display:inline-block;min-width:46px;text-align:right}
.bar{position:relative;display:inline-block;width:90px;height:9px;margin-right:8px;background:var(--faint);
border-radius:2px;vertical-align:baseline}
.bar i{position:absolute;top:0;bottom:0;left:0;background:var(--after);border-radius:2px}
.bar.weak i{background:var(--soft);opacity:.55}
.bar u{position:absolute;top:-3px;bottom:-3px;width:1.5px;background:var(--ink);opacity:.6}
.key{margin:0 0 6px;color:var(--soft);font-size:12.5px}
.key i{display:inline-block;width:18px;height:3px;margin:0 6px 3px 0;vertical-align:middle}
.key i.before,.key i.after{background:var(--c)}.key span{margin-right:18px}
.key i.noise{height:0;border-top:2px dashed var(--soft)}
.key i.measured{background:var(--ink)}.key i.target{height:0;border-top:2px dotted var(--soft)}
.grid2{display:grid;grid-template-columns:repeat(auto-fill,minmax(400px,1fr));gap:6px 14px}
.grid3{display:grid;grid-template-columns:repeat(auto-fill,minmax(290px,1fr));gap:6px 14px}
svg{display:block;overflow:visible;width:100%;height:auto;margin:2px 0;break-inside:avoid}
svg text{font-size:11px;fill:var(--soft)}
svg .title{font-size:12px;font-weight:600;fill:var(--ink)}
svg .middle{text-anchor:middle}svg .end{text-anchor:end}
svg .grid path{stroke:var(--grid);stroke-width:1}
svg .line{fill:none;stroke-width:1;stroke-linejoin:round}
svg .before{stroke:var(--before)}svg .after{stroke:var(--after)}
svg .measured{stroke:var(--ink);stroke-width:1.1}svg .target{stroke:var(--soft);stroke-dasharray:1.5 3}
svg rect.after{fill:var(--after);stroke:none}svg rect.before{fill:var(--before);stroke:none}
svg .thick{stroke-width:1.8}
svg .noise{stroke:var(--soft);stroke-dasharray:4 3}
svg .band{stroke:none}svg .band.before{fill:var(--before);opacity:.16}svg .band.after{fill:var(--after);opacity:.2}
svg circle.after{fill:var(--after);stroke:none}svg circle.before{fill:var(--before);stroke:none}
svg text.note{stroke:none}
details{margin:4px 0}summary{cursor:pointer;color:var(--soft);font-size:13px}
ul{margin:4px 0;padding-left:20px}li{margin:3px 0}
footer{margin-top:48px;padding-top:12px;border-top:1px solid var(--faint);color:var(--soft);font-size:12.5px}
footer td,footer th{font-size:12.5px;padding:2px 10px 2px 0;border:0}
@media print{:root{--ink:#000;--soft:#444;--faint:#ccc;--page:#fff;--card:#f4f4f4;--before:#b86a1f;--after:#1257c4;
--good:#18794e;--bad:#b42318;--grid:#ddd}
body{max-width:none;padding:0;font-size:11px}table,small,.key,code{font-size:10.5px}p.verdict{font-size:15px}h2{margin-top:22px;break-after:avoid}
h3{break-after:avoid}tr{break-inside:avoid}.tile{-webkit-print-color-adjust:exact;print-color-adjust:exact}
.bar,.bar i,tr.taken td{-webkit-print-color-adjust:exact;print-color-adjust:exact}}
"""
