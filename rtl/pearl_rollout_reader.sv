// SPDX-License-Identifier: MIT
// Sends the groups of a rollout's step into the pipeline, each of them twice: to be observed by the policy, and, as
// soon as there are its actions, to be stepped.
//
// Groups come back from the policy in the order in which they were observed. No more of them are under way than
// CREDITS, so that there is room for each wherever it waits.
module pearl_rollout_reader
  import pearl_pkg::*;
#(
    parameter int unsigned GROUPS = 4,
    parameter int unsigned PE_NUM = 4,
    // Cycles from one group to the next; from one that is observed to the next that is.
    parameter int unsigned II = 1,
    parameter int unsigned OBSERVE_II = 1,
    parameter int unsigned CREDITS = 64,
    localparam int unsigned GROUP_BITS = index_bits(GROUPS)
) (
    input  logic                  clk_i,
    input  logic                  rst_ni,
    input  logic                  start_i,
    input  logic [          31:0] first_slot_i,
    // There is a row of actions, which is of the next group to be stepped.
    input  logic                  actions_valid_i,
    // A group enters the pipeline: to be observed, or to be stepped with the row of actions, which is taken.
    output logic                  issue_o,
    output logic                  observe_o,
    output logic [GROUP_BITS-1:0] group_o,
    output logic                  last_o,
    output logic [          31:0] slot_o
);

  localparam int unsigned CREDIT_BITS = $clog2(CREDITS + 1);
  localparam int unsigned WAIT_BITS = index_bits(II);
  localparam int unsigned OBSERVE_WAIT_BITS = index_bits(OBSERVE_II);

  // Groups that are observed and stepped go through the same numbers, one behind the other.
  logic [1:0][GROUP_BITS-1:0] groups_q;
  logic [1:0][31:0] slots_q;
  logic active_q, steps, observes;
  logic [WAIT_BITS-1:0] wait_q;
  logic [OBSERVE_WAIT_BITS-1:0] observe_wait_q;
  logic [CREDIT_BITS-1:0] credits_q;

  assign steps = actions_valid_i && wait_q == '0;
  assign observes = !actions_valid_i && active_q && wait_q == '0 && observe_wait_q == '0 && credits_q != '0;

  assign issue_o = steps || observes;
  assign observe_o = observes;
  assign group_o = groups_q[observe_o];
  assign slot_o = slots_q[observe_o];
  assign last_o = 32'(group_o) == GROUPS - 1;

  always_ff @(posedge clk_i) begin
    if (!rst_ni || start_i) begin
      active_q       <= start_i && rst_ni;
      groups_q       <= '0;
      slots_q        <= {2{first_slot_i}};
      wait_q         <= '0;
      observe_wait_q <= '0;
      credits_q      <= CREDIT_BITS'(CREDITS);
    end else begin
      if (issue_o) begin
        groups_q[observe_o] <= groups_q[observe_o] + 1'b1;
        slots_q[observe_o]  <= slots_q[observe_o] + 32'(PE_NUM);
        credits_q           <= observe_o ? credits_q - 1'b1 : credits_q + 1'b1;
        wait_q              <= WAIT_BITS'(II - 1);
      end else if (wait_q != '0) begin
        wait_q <= wait_q - 1'b1;
      end
      if (observes) begin
        active_q       <= !last_o;
        observe_wait_q <= OBSERVE_WAIT_BITS'(OBSERVE_II - 1);
      end else if (observe_wait_q != '0) begin
        observe_wait_q <= observe_wait_q - 1'b1;
      end
    end
  end

  always_ff @(posedge clk_i) begin
    if (rst_ni && !start_i) begin
      assert (32'(credits_q) < CREDITS || !actions_valid_i)
      else $error("pearl_rollout_reader: actions came that no group waits for");
    end
  end

endmodule
