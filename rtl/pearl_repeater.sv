// SPDX-License-Identifier: MIT
// Makes many steps of one doorbell: rings again when a step is done, until all of a rollout are.
module pearl_repeater (
    input  logic        clk_i,
    input  logic        rst_ni,
    // The host's doorbell; from the next cycle on whether it is for a rollout, and of how many steps.
    input  logic        ring_i,
    input  logic        rollout_i,
    input  logic [31:0] steps_i,
    // A step is done; whether it is the last one.
    input  logic        done_i,
    output logic        last_o,
    // To the sequencer: in the cycle of the doorbell, and in the one after a step.
    output logic        ring_o,
    // A step has ended and the next one not begun.
    output logic        between_o,
    // Steps that are done, and cycles of the doorbell so far, as pearl_sequencer counts them.
    output logic [31:0] steps_o,
    output logic [63:0] cycles_o
);

  logic again_q;
  logic [31:0] steps_q;
  logic [63:0] cycles_q;

  assign last_o = !rollout_i || steps_q + 1'b1 >= steps_i;

  always_ff @(posedge clk_i) begin
    if (!rst_ni) again_q <= 1'b0;
    else again_q <= done_i && !last_o;
    if (!rst_ni || ring_i) steps_q <= '0;
    else if (done_i && rollout_i) steps_q <= steps_q + 1'b1;
    cycles_q <= ring_i ? 64'd2 : cycles_q + 1'b1;
  end

  assign ring_o = ring_i || again_q;
  assign between_o = again_q;
  assign steps_o = steps_q;
  assign cycles_o = cycles_q;

endmodule
