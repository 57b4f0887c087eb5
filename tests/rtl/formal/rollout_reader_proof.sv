// SPDX-License-Identifier: MIT
// Of a rollout's step, whenever actions come back: groups are observed in their order and once each, stepped in their
// order and once each, after they were observed, and no more than CREDITS are between the two.
module rollout_reader_proof
  import pearl_pkg::*;
#(
    parameter int unsigned GROUPS = 5,
    parameter int unsigned PE_NUM = 3,
    parameter int unsigned II = 1,
    parameter int unsigned OBSERVE_II = 1,
    parameter int unsigned CREDITS = 2
) (
    input logic        clk_i,
    input logic        start_i,
    input logic [31:0] first_slot_i,
    input logic        actions_valid_i
);

  localparam int unsigned COUNT_BITS = $clog2(GROUPS + 1);

  logic started_q = 1'b0;
  logic issue, observe, last;
  logic [index_bits(GROUPS)-1:0] group;
  logic [31:0] slot, first_slot_q;
  logic [COUNT_BITS-1:0] observed_q = '0, stepped_q = '0, count;

  pearl_rollout_reader #(
      .GROUPS    (GROUPS),
      .PE_NUM    (PE_NUM),
      .II        (II),
      .OBSERVE_II(OBSERVE_II),
      .CREDITS   (CREDITS)
  ) u_reader (
      .clk_i,
      .rst_ni   (started_q),
      .start_i,
      .first_slot_i,
      .actions_valid_i,
      .issue_o  (issue),
      .observe_o(observe),
      .group_o  (group),
      .last_o   (last),
      .slot_o   (slot)
  );

  always_ff @(posedge clk_i) begin
    started_q <= 1'b1;
    if (!started_q || start_i) begin
      observed_q   <= started_q ? '0 : COUNT_BITS'(GROUPS);
      stepped_q    <= started_q ? '0 : COUNT_BITS'(GROUPS);
      first_slot_q <= first_slot_i;
    end else if (issue) begin
      if (observe) observed_q <= observed_q + 1'b1;
      else stepped_q <= stepped_q + 1'b1;
    end
  end

  assign count = observe ? observed_q : stepped_q;

  always_comb begin
    // A step begins when the one before has ended, and actions are of groups that were observed.
    assume (!start_i || (stepped_q == COUNT_BITS'(GROUPS) && !issue));
    assume (!actions_valid_i || (started_q && stepped_q < observed_q));
  end

  always_ff @(posedge clk_i) begin
    if (started_q) begin
      if (issue) begin
        once : assert (32'(count) < GROUPS);
        in_order : assert (32'(group) == 32'(count));
        ends : assert (last == (32'(count) == GROUPS - 1));
        of_slot : assert (slot == first_slot_q + 32'(count) * PE_NUM);
        earlier : assert (observe || stepped_q < observed_q);
      end
      bounded : assert (stepped_q <= observed_q && 32'(observed_q) <= 32'(stepped_q) + CREDITS);
`ifndef PROPERTY_ONLY
      assert (32'(observed_q) <= GROUPS);
      assert (u_reader.active_q == (32'(observed_q) < GROUPS));
      if (32'(stepped_q) < GROUPS) begin
        assert (32'(u_reader.credits_q) + 32'(observed_q) == CREDITS + 32'(stepped_q));
        assert (32'(u_reader.groups_q[0]) == 32'(stepped_q));
        assert (u_reader.slots_q[0] == first_slot_q + 32'(stepped_q) * PE_NUM);
      end
      if (u_reader.active_q) begin
        assert (32'(u_reader.groups_q[1]) == 32'(observed_q));
        assert (u_reader.slots_q[1] == first_slot_q + 32'(observed_q) * PE_NUM);
      end
`endif
    end
  end

endmodule
